"""Tilesets in a folder: the same files in one go, in many, after any kind of end."""

import fcntl
import json
import shutil
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from errno import ENOSPC
from pathlib import Path

import numpy as np
import pytest

from lattices import ArrayLattice
from rtin import _decimated
from rtin.io import tileset
from rtin.io.tileset import write_tileset
from rtin.pyramid import Plan, tolerances
from test_pyramid import rough

CELLS, ROOTS, LAST = 16, 2, 3
PERIOD = CELLS * ROOTS << LAST
FULL = OSError(ENOSPC, "No space left on device")


@dataclass(frozen=True)
class Plain:
    """Tiles as the bytes of their arrays; ``fail`` names one that can't be made."""

    fail: str = ""

    def name(self, zoom, row, col):
        return f"{zoom}/{row}/{col}.bin"

    def encode(self, zoom, tile, largest_range):
        if self.name(zoom, tile.row, tile.col) == self.fail:
            raise FULL
        head = f"{zoom} {self.rounding(zoom, largest_range)}".encode()
        return head + tile.heights.tobytes() + tile.triangles.tobytes()

    def rounding(self, zoom, largest_range):
        return 0.125 if largest_range < 4096.0 else 0.5

    def roots(self, zoom):
        return frozenset([(0, 0), (0, 1)]) if zoom == 0 else frozenset()

    def index(self, records, tolerances):
        known = [list(vars(record).values())[:9] for record in records()]
        yield "index.json", json.dumps([tolerances, known]).encode()


def lattice_of(change=None, **options):
    heights = rough(75, 101, **options)
    if change is not None:
        change(heights)
    return ArrayLattice(heights, PERIOD, first=(21, PERIOD - 37))


def write(folder, lattice=None, source="1", *, output=Plain(), settings=None, fill=0.0, **options):
    plan = Plan(lattice or lattice_of(), CELLS, ROOTS, tolerances(0, LAST, [4.0], None), fill)
    return write_tileset(
        folder, plan, output, settings=settings or {"a": 1, "b": [2.5, None]},
        sources={"dem": source}, **options,
    )  # fmt: skip


def contents(folder, *, state=False):
    """{path: bytes} of all files but those of the state."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and (state or ".rtin" not in path.parts)
    }


def written_by(folder, action):
    """Names of the tiles that an action writes, and what it returns."""
    before = {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in folder.rglob("*.bin")}
    result = action()
    return {
        str(path.relative_to(folder))
        for path in folder.rglob("*.bin")
        if before.get(path) != (path.stat().st_mtime_ns, path.stat().st_ino)
    }, result


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder made in one go; tests copy it."""
    folder = tmp_path_factory.mktemp("tilesets") / "whole"
    write(folder)
    return folder


@pytest.fixture
def copy(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "copy"))


def test_a_summary_counts_what_there_is(tmp_path):
    shares = []
    made = write(tmp_path / "new" / "tiles", tell=shares.append)
    files = contents(tmp_path / "new" / "tiles")
    assert [level.zoom for level in made.levels] == list(range(LAST + 1))
    assert made.n_made == sum(level.n_tiles for level in made.levels) == len(files) - 1
    assert made.n_removed == 0
    for level in made.levels:
        tiles = [data for name, data in files.items() if name.startswith(f"{level.zoom}/")]
        assert (level.n_tiles, level.n_bytes) == (len(tiles), sum(map(len, tiles)))
        assert level.tolerance == 4.0 * 2 ** (LAST - level.zoom)
        assert 0.125 < level.max_error <= level.tolerance + 0.125
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 0.4
    assert shares[-1] == 1.0


def test_the_index_is_told_what_is_true_of_each_tile(whole):
    wanted, records = json.loads((whole / "index.json").read_text())
    assert wanted == {str(zoom): 4.0 * 2 ** (LAST - zoom) for zoom in range(LAST + 1)}
    names = [f"{zoom}/{row}/{col}.bin" for zoom, row, col, *_ in records]
    assert sorted(names) == sorted(name for name in contents(whole) if name.endswith(".bin"))
    assert records == sorted(records)
    for name, (_, _, _, n_bytes, n_vertices, n_triangles, error, low, high) in zip(
        names, records, strict=True
    ):
        data = (whole / name).read_bytes()
        head = len(data) - 8 * n_vertices - 12 * n_triangles
        heights = np.frombuffer(data[head : head + 8 * n_vertices])
        assert len(data) == n_bytes
        assert (heights.min(), heights.max()) == (low, high)
        assert error >= 0.0


def test_a_finished_set_is_left_as_it_is(copy, whole):
    shares = []
    assert not written_by(copy, lambda: write(copy, tell=shares.append))[0]
    assert not shares
    assert contents(copy) == contents(whole)
    assert write(copy).n_made == 0


def test_workers_change_nothing(tmp_path, whole, monkeypatch):
    monkeypatch.setattr("rtin.tiles._BLOCK_CELLS", 2 * CELLS)
    monkeypatch.setattr(tileset, "_BATCH", 2)
    monkeypatch.setattr(tileset, "_MOST_IN_FLIGHT", 3)
    with ThreadPoolExecutor(4) as executor:
        write(tmp_path / "tiles", executor=executor)
    assert contents(tmp_path / "tiles") == contents(whole)


def test_lost_tiles_are_made_again_and_no_others(copy, whole):
    lost = ["3/2/15.bin", "0/0/1.bin", "2/1/0.bin"]
    for name in lost:
        (copy / name).unlink()
    assert written_by(copy, lambda: write(copy))[0] == set(lost)
    assert contents(copy) == contents(whole)


@pytest.mark.parametrize("zoom", range(LAST + 1))
@pytest.mark.parametrize("with_workers", [False, True])
def test_what_fails_in_the_middle_goes_on_where_it_was(
    tmp_path, whole, monkeypatch, zoom, with_workers
):
    monkeypatch.setattr(tileset, "_BATCH", 2)
    tiles, wanted = tmp_path / "tiles", contents(whole)
    name = [name for name in wanted if name.startswith(f"{zoom}/")][-1]
    with ThreadPoolExecutor(2) as executor, pytest.raises(OSError, match="No space left"):
        write(tiles, output=Plain(fail=name), executor=executor if with_workers else None)
    had = contents(tiles)
    assert name not in had
    assert had.items() <= wanted.items()  # whatever there is is whole
    n_finer = sum(other.startswith(tuple("0123"[zoom + 1 :])) for other in wanted)
    assert len(had) >= n_finer
    assert write(tiles).n_made <= len(wanted) - 1 - n_finer
    assert contents(tiles) == wanted


@pytest.mark.parametrize(
    ("module", "name"),
    [(_decimated, "_write"), (np, "savez"), (tileset, "_write"), (Path, "mkdir"), (Path, "open")],
)
@pytest.mark.parametrize("n_good", [0, 3])
def test_a_full_disk_is_an_error_and_the_next_run_finishes(
    tmp_path, whole, monkeypatch, module, name, n_good
):
    calls, right = [], getattr(module, name)

    def full(*arguments, **options):
        calls.append(arguments)
        if len(calls) > n_good:
            raise OSError(ENOSPC, "No space left on device")
        return right(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(module, name, full)
        with pytest.raises(OSError, match="No space left on device"):
            write(tmp_path / "tiles")
    assert contents(tmp_path / "tiles").items() <= contents(whole).items()
    write(tmp_path / "tiles")
    assert contents(tmp_path / "tiles") == contents(whole)


def test_a_disk_too_full_for_the_table_is_an_error_that_names_it(tmp_path, whole, monkeypatch):
    def insert(table, records):
        table.execute("PRAGMA max_page_count = 1")
        table.execute("CREATE TABLE more (a)")

    with monkeypatch.context() as patch:
        patch.setattr(tileset, "_insert", insert)
        with pytest.raises(OSError, match=r"tiles\.sqlite: database or disk is full"):
            write(tmp_path / "tiles")
    assert write(tmp_path / "tiles").n_made > 0
    assert contents(tmp_path / "tiles") == contents(whole)


def test_a_damaged_table_is_an_error_that_names_it(copy):
    (copy / ".rtin" / "tiles.sqlite").write_bytes(b"no database" * 1000)
    with pytest.raises(OSError, match=r"tiles\.sqlite: file is not a database"):
        write(copy)


def test_what_a_killed_run_left_half_written_is_removed(copy, whole):
    for name in (".3.0a1b2c3d.part.bin", "2/1/.0.0a1b2c3d.part.bin", ".rtin/.job.00.part.json"):
        (copy / name).write_bytes(b"half")
    write(copy)
    assert contents(copy) == contents(whole)
    assert not list(copy.rglob("*.part*"))


# --- rasters that change ------------------------------------------------------------------------


def raise_a_patch(heights):
    heights[40:44, 50:54] += 30.0


def lose_the_west(heights):
    heights[:, :60] = np.nan


def lose_all_but_a_corner(heights):
    heights[10:] = np.nan


def gain_a_peak_beyond_the_range(heights):
    heights[3, 3] = 9000.0


@pytest.mark.parametrize("fill", [0.0, None])
@pytest.mark.parametrize(
    "change", [raise_a_patch, lose_the_west, lose_all_but_a_corner, gain_a_peak_beyond_the_range]
)
def test_an_update_is_what_would_be_made_afresh(tmp_path, change, fill):
    afresh, tiles = tmp_path / "afresh", tmp_path / "tiles"
    write(afresh, lattice_of(change), "2", fill=fill)
    write(tiles, fill=fill)
    before = contents(tiles)
    written, made = written_by(
        tiles, lambda: write(tiles, lattice_of(change), "2", fill=fill, update=True)
    )
    after = contents(tiles)
    assert after == contents(afresh)
    assert made.n_removed == len(before.keys() - after.keys())
    assert made.n_made == len(written)
    tiles_after = {name: data for name, data in after.items() if name.endswith(".bin")}
    assert written >= {name for name, data in tiles_after.items() if data != before.get(name)}
    if change is raise_a_patch:
        assert 0 < len(written) < len(after) / 2
    if change in (lose_the_west, lose_all_but_a_corner):
        assert made.n_removed > 5
    # And back again.
    write(tiles, source="1", fill=fill, update=True)
    assert contents(tiles) == before


def test_an_update_that_was_ended_goes_on(copy, tmp_path, whole, monkeypatch):
    monkeypatch.setattr(tileset, "_BATCH", 1)
    changed = lattice_of(raise_a_patch)
    write(tmp_path / "afresh", changed, "2")
    wanted, before = contents(tmp_path / "afresh"), contents(whole)
    name = next(n for n in wanted if wanted[n] != before[n] and n.startswith("1/"))
    with pytest.raises(OSError, match="No space left"):
        write(copy, changed, "2", update=True, output=Plain(fail=name))
    had = contents(copy)
    assert had != before
    assert all(data in (wanted[name], before[name]) for name, data in had.items())
    write(copy, changed, "2")  # the state knows of the change by now
    assert contents(copy) == wanted


def test_an_update_that_was_ended_can_be_taken_back(copy, tmp_path, whole):
    changed = lattice_of(lambda heights: np.negative(heights, out=heights))
    write(tmp_path / "afresh", changed, "2")
    one = next(n for n in contents(whole) if n.startswith("2/"))
    with pytest.raises(OSError, match="No space left"):
        write(copy, changed, "2", update=True, output=Plain(fail=one))
    # A tile was written, and the run was killed before it was noted.
    shutil.copy(tmp_path / "afresh" / one, copy / one)
    write(copy, source="1", update=True)
    assert contents(copy) == contents(whole)


def test_what_an_ended_run_wrote_and_did_not_note_is_removed_by_the_next(copy, whole):
    job = copy / ".rtin" / "job.json"
    job.write_text(json.dumps(json.loads(job.read_text()) | {"finished": False}))
    (copy / "3" / "7").mkdir(exist_ok=True)
    unknown = copy / "3" / "7" / "15.bin", copy / "3" / "7" / "15.json"
    for path in unknown:
        path.write_bytes(b"of an earlier raster")
    users = copy / "3" / "7" / "notes.txt"
    users.write_text("mine")
    assert not any((whole / path.relative_to(copy)).exists() for path in unknown)
    write(copy)
    assert users.read_text() == "mine"
    users.unlink()
    assert contents(copy) == contents(whole)


def test_an_update_that_ends_at_once_leaves_no_settled_borders_without_heights(
    copy, whole, monkeypatch
):
    unlink = Path.unlink

    def stop(path, **options):
        if path.name.startswith("heights-"):
            unlink(path)
            raise KeyboardInterrupt
        unlink(path, **options)

    monkeypatch.setattr(Path, "unlink", stop)
    with pytest.raises(KeyboardInterrupt):
        write(copy, source="2", update=True)
    monkeypatch.undo()
    shutil.rmtree(copy / "2")
    write(copy)
    assert contents(copy) == contents(whole)


def test_borders_of_the_largest_tiles_have_a_digest():
    plan = Plan(lattice_of(), CELLS, ROOTS, tolerances(0, LAST, [4.0], None), 0.0)
    tiling = plan.tiling(plan.lattice, LAST)
    borders = dict.fromkeys(tiling.edges((0, 0)), 1 << 16384)
    batch = tileset._Batch(Path(), Plain(), LAST, tiling, 1.0, b"", [(0, 0)], borders, {})
    fewer = tileset._Batch(Path(), Plain(), LAST, tiling, 1.0, b"", [(0, 0)], {}, {})
    heights = np.zeros((3, 3), np.float32)
    assert tileset._key(batch, (0, 0), heights) != tileset._key(fewer, (0, 0), heights)


def test_a_tile_of_another_length_is_made_anew(copy, whole):
    (copy / "2/1/0.bin").write_bytes(b"half")
    assert written_by(copy, lambda: write(copy))[0] == {"2/1/0.bin"}
    assert contents(copy) == contents(whole)


def test_a_changed_raster_is_not_mixed_in_without_being_asked(copy, whole):
    with pytest.raises(ValueError, match=r"^dem changed since .*copy was made; add --update"):
        write(copy, lattice_of(raise_a_patch), "2")
    assert contents(copy, state=True).keys() >= contents(whole).keys()
    assert not written_by(copy, lambda: write(copy))[0]


def test_rasters_in_another_order_are_a_change(copy):
    def again(sources, **options):
        plan = Plan(lattice_of(), CELLS, ROOTS, tolerances(0, LAST, [4.0], None), 0.0)
        settings = {"a": 1, "b": [2.5, None]}
        return write_tileset(copy, plan, Plain(), settings=settings, sources=sources, **options)

    with pytest.raises(ValueError, match=r"^dem, other changed since"):
        again({"dem": "3", "other": "2"})
    again({"dem": "1", "other": "2"}, update=True)
    with pytest.raises(ValueError, match=r"^the order of the rasters changed since"):
        again({"other": "2", "dem": "1"})
    with pytest.raises(ValueError, match=r"^other changed since"):
        again({"dem": "1"})


# --- folders that are not for it ----------------------------------------------------------------


def test_other_settings_want_another_folder(copy, whole):
    with pytest.raises(FileExistsError, match=r"holds tiles made with a = 1, not 2; name another"):
        write(copy, settings={"a": 2, "b": [2.5, None]})
    with pytest.raises(FileExistsError, match=r"made with c = None, not 3"):
        write(copy, settings={"a": 1, "b": [2.5, None], "c": 3})
    assert contents(copy) == contents(whole)


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="is not empty and holds no tileset"):
        write(tmp_path)
    assert contents(tmp_path, state=True) == {"mine.txt": b"mine"}
    with pytest.raises(FileExistsError, match=r"mine\.txt is a file; name a folder"):
        write(tmp_path / "mine.txt")


def test_an_empty_folder_is_taken(tmp_path, whole):
    write(tmp_path)
    assert contents(tmp_path) == contents(whole)


def test_a_folder_that_another_run_fills_is_left_alone(copy, whole):
    with (copy / ".rtin" / "lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(OSError, match="copy is being written by another run"):
            write(copy, source="2", update=True)
    assert contents(copy) == contents(whole)
    assert write(copy).n_made == 0


def test_the_state_says_whether_all_is_there(copy, tmp_path):
    def is_finished(folder):
        return json.loads((folder / ".rtin" / "job.json").read_text())["finished"]

    assert is_finished(copy)
    with pytest.raises(OSError, match="No space left"):
        write(tmp_path / "half", output=Plain(fail="3/2/15.bin"))
    assert not is_finished(tmp_path / "half")
    table = sqlite3.connect(copy / ".rtin" / "tiles.sqlite")
    counted = table.execute("SELECT count(*) FROM tiles WHERE n_bytes > 0").fetchone()[0]
    table.close()
    assert counted == len(contents(copy)) - 1
