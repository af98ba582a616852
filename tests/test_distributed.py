"""`distributed`: results do not know of workers, lost ones included."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import rtin
import terrains
from lattices import ArrayLattice, total
from rtin.tiles import Tiling, make_tiles, settle_borders

dask = pytest.importorskip("dask")
pytest.importorskip("distributed")

from rtin.distributed import cluster  # noqa: E402

PYTHONPATH = os.pathsep.join([str(Path(__file__).parent), *sys.path])
_PATIENCE = 600  # seconds, with a busy machine
ENVIRONMENT = {**os.environ, "PYTHONPATH": PYTHONPATH}


@pytest.fixture(scope="module")
def two_workers():
    with cluster(workers=2) as executor:
        yield executor


@pytest.fixture(scope="module")
def tiling():
    heights = terrains.waves((150, 200)) + terrains.noise((150, 200)) / 32
    return Tiling.of_raster(ArrayLattice(heights), 16, 1.5)


def rows_of(tiling):
    return [[place for place in tiling.tiles() if place[0] == row] for row in range(10)]


def checksum_of_row(tiling, borders, places):
    return total(make_tiles(tiling, places, borders))


def checksum(tiling, executor):
    """Of all tiles: borders and tiles on an executor."""
    borders = settle_borders(tiling, executor=executor).borders
    run = map if executor is None else executor.map
    return sum(run(partial(checksum_of_row, tiling, borders), rows_of(tiling))) % 2**64


@pytest.fixture(autouse=True)
def many_blocks(monkeypatch):
    monkeypatch.setattr(rtin.tiles, "_BLOCK_CELLS", 32)


def test_two_workers_make_the_same_mesh(tiling, two_workers):
    assert checksum(tiling, two_workers) == checksum(tiling, None)


def test_map_is_map(two_workers):
    assert list(two_workers.map(pow, [2, 3, 4], iter([5, 2, 3]))) == [32, 9, 64]
    assert list(two_workers.map(max, [(1, 2), (3, 4)])) == [2, 4]
    assert list(two_workers.map(pow, [], [])) == []
    assert list(two_workers.map(pow, [2, 3, 4], [5])) == [32]


def test_submit_calls_with_options(two_workers):
    assert two_workers.submit(sorted, [2, 3, 1], reverse=True).result() == [3, 2, 1]


def test_what_a_call_raises_is_raised_here(two_workers):
    with pytest.raises(ZeroDivisionError):
        list(two_workers.map(divmod, [1, 1], [1, 0]))


def test_results_do_not_pile_up(two_workers):
    taken = []
    results = two_workers.map(abs, (taken.append(n) or n for n in range(-100, 0)))
    assert len(taken) == 8
    assert next(results) == 100
    assert len(taken) == 9
    results.close()
    assert len(taken) == 9


class Counted:
    """A function of 3 MB that tells how often it was pickled here."""

    n_pickled = 0

    def __init__(self):
        self.ballast = np.random.default_rng(0).random(400_000)

    def __getstate__(self):
        Counted.n_pickled += 1
        return self.__dict__

    def __call__(self, value):
        return value + 1


def test_a_function_is_sent_once_however_often_it_is_called(two_workers):
    function = Counted()
    Counted.n_pickled = 0
    assert list(two_workers.map(function, range(50))) == list(range(1, 51))
    assert Counted.n_pickled <= 2  # Dask may try another protocol


@pytest.mark.parametrize("backing", ["numpy", "dask", "persisted"])
def test_arrays_in_tiles_are_the_same_on_a_cluster(two_workers, backing):
    xarray = pytest.importorskip("xarray")
    import rtin.accessor  # noqa: F401

    data = xarray.DataArray(terrains.waves((66, 90)), dims=("y", "x"))
    here = data.rtin.coarsen_tiles(1.5, cells=16).mesh()
    if backing != "numpy":
        data = data.chunk(40)
    with two_workers._client.as_current():
        if backing == "persisted":
            data = data.persist()
        there = data.rtin.coarsen_tiles(1.5, cells=16, executor=two_workers).mesh()
    assert there.vertices.tobytes() == here.vertices.tobytes()
    assert there.triangles.tobytes() == here.triangles.tobytes()


# --- workers that die ---------------------------------------------------------------------------


def die_once(flag, value):
    """Kill the own process in the middle of the work, the first time."""
    if value == 3 and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return value


def test_a_worker_killed_in_the_middle_costs_no_result(tmp_path, tiling, two_workers):
    borders = settle_borders(tiling, executor=two_workers).borders
    calls = two_workers.map(partial(dying_row, tmp_path, tiling, borders), rows_of(tiling))
    assert sum(calls) % 2**64 == checksum(tiling, None)
    assert (tmp_path / "died").exists()


def dying_row(folder, tiling, borders, places):
    if places[0][0] == 3:
        die_once(folder / "died", 3)
    return checksum_of_row(tiling, borders, places)


def test_a_worker_lost_for_good_leaves_its_work_to_the_other(tiling, two_workers):
    client = two_workers._client
    borders = settle_borders(tiling, executor=two_workers).borders
    results = two_workers.map(partial(slow_row, tiling, borders), rows_of(tiling))
    first = next(results)
    lost = client.cluster.workers[0]
    lost.auto_restart = False
    os.kill(lost.pid, signal.SIGKILL)
    while len(client.nthreads()) == 2:
        time.sleep(0.05)
    assert (first + sum(results)) % 2**64 == checksum(tiling, None)
    client.cluster.scale(2)
    client.wait_for_workers(2)


def slow_row(tiling, borders, places):
    time.sleep(0.05)
    return checksum_of_row(tiling, borders, places)


def die(_value):
    os.kill(os.getpid(), signal.SIGKILL)


def test_work_that_kills_every_worker_ends_with_one_line():
    error = pytest.raises(OSError, match="want of memory")
    at_once = dask.config.set({"distributed.scheduler.allowed-failures": 0})
    with error as raised, at_once, cluster(workers=1) as executor:
        executor.submit(die, 1).result()
    assert "\n" not in str(raised.value)


# --- a scheduler elsewhere ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def scheduler():
    """Address of a scheduler and a worker, each a process of its own."""
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    with subprocess.Popen(
        [*command, "--port", "0", "--no-dashboard", "--host", "127.0.0.1"],
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    ) as process:
        address = next(line.split()[-1] for line in process.stderr if "Scheduler at:" in line)
        yield address
        process.terminate()


@pytest.fixture
def worker(scheduler):
    command = [sys.executable, "-m", "distributed.cli.dask_worker", scheduler, "--no-dashboard"]
    with subprocess.Popen(
        [*command, "--nthreads", "2", "--no-nanny"], stderr=subprocess.DEVNULL, env=ENVIRONMENT
    ) as process:
        yield process
        process.terminate()


def test_threads_of_a_worker_elsewhere_make_the_same_mesh(scheduler, worker, tiling):
    with cluster(scheduler, timeout=_PATIENCE) as executor:
        assert checksum(tiling, executor) == checksum(tiling, None)
    with cluster(scheduler, timeout=_PATIENCE) as executor:  # which is still there
        assert list(executor.map(abs, [-1])) == [1]


def test_workers_of_another_version_are_refused(scheduler, worker, monkeypatch):
    monkeypatch.setattr("rtin.distributed.__version__", "9.9")
    error = pytest.raises(ConnectionError, match=r"runs rtin .*, this is 9\.9; install the same")
    with error, cluster(scheduler, timeout=_PATIENCE):
        pass


def test_a_scheduler_without_workers_is_refused(scheduler):
    error = pytest.raises(ConnectionError, match="has no workers; start some: dask worker tcp://")
    with error, cluster(scheduler, timeout=0.5):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere", "nowhere:12", "", "ftp://a:1"])
def test_a_scheduler_that_is_not_there_is_named_in_one_line(address):
    error = pytest.raises(ConnectionError, match="no Dask scheduler can be reached at")
    with error as raised, cluster(address, timeout=0.5):
        pass
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"workers": 0}, ValueError, "workers must be at least 1, got 0"),
        ({"workers": 2.5}, TypeError, "workers must be a whole number, got 2.5"),
        ({"workers": True}, TypeError, "workers must be a whole number, got True"),
        ({"scheduler": "tcp://a:1", "workers": 2}, ValueError, "not both"),
        ({"timeout": "5"}, TypeError, "timeout must be a number"),
    ],
)
def test_refuses_what_is_no_cluster(options, error, message):
    with pytest.raises(error, match=message), cluster(**options):
        pass


def test_without_dask_it_says_what_to_install():
    code = "import sys; sys.modules['distributed'] = None; from rtin.distributed import cluster\n"
    code += "with cluster(workers=1): pass"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.stderr.splitlines()[-1].endswith("pip install 'rtin[dask]'")


PROGRAM = """
import time
from rtin.distributed import cluster

if __name__ == "__main__":
    try:
        with cluster(workers=2) as executor:
            results = executor.map(time.sleep, [600, 600])
            time.sleep(1)  # until both are under way
            print("working", flush=True)
            list(results)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
"""


def test_ctrl_c_ends_it_without_a_word(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    with subprocess.Popen(
        [sys.executable, str(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout.readline() == "working\n"
        began = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: workers get it too
        out, err = process.communicate()
    assert time.monotonic() - began < 500  # workers had yet to sleep for longer
    assert (out, err, process.returncode) == ("interrupted\n", "", 0)
