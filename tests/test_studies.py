"""The study of propagation: what it builds, what it finds, and how the command line shows it."""

import json
from itertools import pairwise

import numpy as np
import pytest
from typer.testing import CliRunner

import meshes
import rtin
from rtin import cli, validity
from rtin.studies import pictures, propagation

UNIFORM = propagation.uniform_mesh()
PNG = b"\x89PNG"


def from_uniform(_seed):
    return UNIFORM


def run(*arguments):
    return CliRunner().invoke(cli.app, ["study", "propagation", *map(str, arguments)])


@pytest.fixture(scope="module")
def study():
    return propagation.measure(20, 300)


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(propagation, "_SMALL_TIN", 100)


@pytest.fixture
def small_long_runs(small, monkeypatch):
    monkeypatch.setattr(propagation, "_LONG_CHECKPOINTS", (1, 10, 1000, 10_000, 100_000))
    monkeypatch.setattr(propagation, "_LONG_SEEDS", 4)
    monkeypatch.setattr(propagation, "_LONGEST", 100_001)
    monkeypatch.setattr(propagation, "_LONGEST_SEEDS", 1)
    monkeypatch.setattr(propagation, "_LONG_TINS", {50: 3, 100: 2})
    monkeypatch.setattr(propagation, "_INSIDE_OF", 100)


# --- meshes -------------------------------------------------------------------------------------


def places(mesh):
    corners = mesh.vertices[mesh.triangles, :2] / mesh.bounds[1, :2]
    return {frozenset(map(tuple, triangle)) for triangle in corners.tolist()}


def test_the_uniform_mesh_is_the_papers():
    assert UNIFORM.n_triangles == 128
    validity.check(UNIFORM)
    coarsened = meshes.uniform(8)
    assert len(places(UNIFORM)) == 128
    shifted = rtin.TriangleMesh(
        coarsened.vertices - [*coarsened.bounds[0, :2], 0.0], coarsened.triangles
    )
    assert places(UNIFORM) == places(shifted)


def test_delaunay_meshes_are_right_and_differ_by_seed():
    one, again, other = (propagation.random_tin(200, seed) for seed in (0, 0, 1))
    validity.check(one)
    assert one.n_vertices == 200
    assert one.vertices.tobytes() == again.vertices.tobytes()
    assert one.vertices.tobytes() != other.vertices.tobytes()


@pytest.mark.parametrize("n_triangles", [1, 2, 3, 50, 5000])
def test_each_triangle_of_the_strip_shares_its_longest_edge_with_the_next(n_triangles):
    strip = propagation.growing_strip(n_triangles)
    validity.check(strip)
    longest = np.sort(strip.triangles[:, :2], axis=1)
    first = np.arange(n_triangles)
    assert longest.tolist() == np.column_stack([first + 1, first + 2]).tolist()
    assert rtin.propagation(strip, [0]).m1 == n_triangles - 1


# --- random refinement --------------------------------------------------------------------------


def test_means_are_those_of_the_meshes_on_the_way():
    seed, splits = 5, [0, 7, 20]
    run = propagation.evolution(from_uniform, splits, [seed])
    on_the_way = propagation.random_refinements(UNIFORM, splits, np.random.default_rng(seed))
    for i, mesh in enumerate(on_the_way):
        validity.check(mesh)
        found = rtin.propagation(mesh)
        assert (run.m1[0, i], run.m2[0, i]) == (found.m1.mean(), found.m2.mean())
        assert run.n_triangles[0, i] == mesh.n_triangles
    assert run.m1_counts @ np.arange(len(run.m1_counts)) == found.m1.sum()
    assert run.m2_counts @ np.arange(len(run.m2_counts)) == found.m2.sum()
    assert run.mesh.triangles.tobytes() == mesh.triangles.tobytes()


def test_every_refinement_takes_one_triangle_of_the_mesh_as_it_is():
    rng = np.random.default_rng(0)
    counts = [mesh.n_triangles for mesh in propagation.random_refinements(UNIFORM, range(60), rng)]
    rng, adaptive = np.random.default_rng(0), rtin.AdaptiveMesh(UNIFORM)
    for before, after in pairwise(counts):
        assert adaptive.n_triangles == before
        adaptive.refine([int(rng.integers(before))])
        assert adaptive.n_triangles == after > before + 3


def test_a_seed_gives_one_run_however_often_it_is_looked_at():
    often = propagation.evolution(from_uniform, range(0, 41, 4), [3, 4])
    seldom = propagation.evolution(from_uniform, [40], [4, 3])
    assert often.m1[::-1, -1].tolist() == seldom.m1[:, 0].tolist()
    assert often.m1_counts.tolist() == seldom.m1_counts.tolist()
    assert often.m1[0, -1] != often.m1[1, -1]


def test_no_seed_is_no_run():
    with pytest.raises(ValueError, match="at least one seed"):
        propagation.evolution(from_uniform, [1], [])


@pytest.mark.parametrize(("numbers", "name"), [((0, 300), "n_seeds"), ((3, -1), "n_splits")])
def test_measures_at_least_one_of_each(numbers, name):
    with pytest.raises(ValueError, match=f"{name} must be one or more"):
        propagation.measure(*numbers)


# --- what is found ------------------------------------------------------------------------------


def test_figure_3_is_reproduced(study):
    assert study.uniform == (4.5, 2.0)
    assert study.uniform_inside == propagation.PAPER["uniform"]
    mean, spread = study.runs.last
    assert 7.2 < mean.m1 < 7.4
    assert 3.65 < mean.m2 < 3.85
    assert 0.0 < spread.m1 < 0.2
    assert (study.runs.splits[0], study.runs.splits[-1]) == (0, 300)
    assert study.one_run.splits.tolist() == list(range(301))
    assert study.one_run.m1[0, -1] == study.runs.m1[0, -1]
    assert study.runs.m1.mean(axis=0)[0] == 4.5


def test_delaunay_meshes_start_above_and_come_down_to_the_same(study):
    mean, _ = study.tins.last
    assert 7.8 < mean.m1 < 8.1
    assert 4.0 < mean.m2 < 4.2
    seldom = propagation.evolution(lambda seed: propagation.random_tin(100, seed), [5000], [0, 1])
    assert seldom.m1[:, -1] == pytest.approx(7.41, abs=0.08)
    assert seldom.m2[:, -1] == pytest.approx(3.82, abs=0.08)


@pytest.mark.parametrize(
    ("place", "m1", "m2"), [("corner", 3, 2), ("border", 5, 2), ("centre", 9, 5)]
)
def test_at_one_place_the_largest_m2_grows_by_two_and_the_cost_of_a_step_does_not(place, m1, m2):
    worst = propagation.refine_at(propagation.PLACES[place], 12)
    assert worst.largest_m2.tolist() == [2 * step for step in range(1, 13)]
    assert set(worst.target_m1[2:].tolist()) == {m1}
    assert set(worst.target_m2[2:].tolist()) == {m2}


def test_touched_are_the_target_and_m1_others(study):
    mesh = study.worst["corner"].mesh
    m1 = rtin.propagation(mesh).m1
    for target in range(0, mesh.n_triangles, 7):
        touched = propagation.touched_by(mesh, target)
        assert target in touched
        assert len(touched) == m1[target] + 1


# --- tables and pictures ------------------------------------------------------------------------


def test_the_table_has_the_papers_figures_beside_ours(study):
    rows = {row.quantity: row for row in propagation.rows(study)}
    m2 = rows["M2, after 300 splits, 20 seeds"]
    assert (m2.paper, m2.ours) == (3.8, study.runs.m2[:, -1].mean())
    assert m2.spread == pytest.approx(study.runs.m2[:, -1].std(ddof=1))
    lines = propagation.as_text(list(rows.values())).splitlines()
    assert len(lines) == len(rows) + 1
    assert any(line.split()[-4:-2] == ["7.3", f"{study.runs.m1[:, -1].mean():.3f}"]
               for line in lines)  # fmt: skip


def test_one_seed_has_no_spread(small):
    assert all(row.spread is None for row in propagation.rows(propagation.measure(1, 2)))


def test_long_runs_are_tabled_and_drawn(small_long_runs, monkeypatch, tmp_path):
    monkeypatch.setattr(propagation, "random_refinements", _without_the_work)
    stages = []
    study = propagation.measure(2, 5, long=True, stage=lambda name: stages.append(name) or _Quiet())
    quantities = [row.quantity for row in propagation.rows(study)]
    assert len(set(quantities)) == len(quantities)
    for wanted in ("M1, after 100 000 splits, 4 seeds", "M2, after 100 001 splits, 1 seed",
                   "M1, Delaunay mesh of 50 points, 3 seeds"):  # fmt: skip
        assert wanted in quantities
    assert len(stages) > 6
    uniform = [means.m1 for means in study.long.uniform_tin]
    assert uniform == sorted(uniform, reverse=True)
    assert 5.0 < uniform[-1] < 5.3
    written = pictures.write_pictures(study, tmp_path)
    assert [path.name for path in written] == list(pictures.PICTURES)


class _Quiet:
    def __enter__(self):
        return None

    def __exit__(self, *_):
        return None


def _without_the_work(mesh, checkpoints, rng):
    """As many meshes, of a few refinements."""
    adaptive = rtin.AdaptiveMesh(mesh)
    for _ in checkpoints:
        adaptive.refine([int(rng.integers(adaptive.n_triangles))])
        yield adaptive.mesh


def test_pictures_are_written_whole_and_small(study, tmp_path):
    written = pictures.write_pictures(study, tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(written)
    for path in written:
        assert path.read_bytes().startswith(PNG)
        assert path.stat().st_size < 120_000


# --- the command line ---------------------------------------------------------------------------


def test_the_command_prints_a_table_and_says_where_the_pictures_are(small, tmp_path):
    out = tmp_path / "new" / "folder"
    result = run("--seeds", 2, "--splits", 20, "--out", out)
    assert result.exit_code == 0, result.output
    assert "paper" in result.stdout
    assert "7.3" in result.stdout
    for name in ("figure-3.png", "histograms.png", "worst-cases.png"):
        assert str(out / name) in result.stdout
        assert (out / name).read_bytes().startswith(PNG)


def test_the_command_gives_json_and_has_a_folder_of_its_own(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("--seeds", 1, "--splits", 3, "--json")
    summary = json.loads(result.stdout)
    assert (summary["seeds"], summary["splits"]) == (1, 3)
    row = next(row for row in summary["rows"] if row["quantity"] == "M1, after 3 splits, 1 seed")
    assert row["paper"] == 7.3
    assert row["spread"] is None
    assert 4.0 < row["ours"] < 6.0
    assert summary["written"][0].startswith("study-propagation")
    assert (tmp_path / "study-propagation" / "figure-3.png").exists()


@pytest.mark.parametrize(
    "options", [["--seeds", 0], ["--seeds", "few"], ["--splits", 0], ["--splits", 1.5], ["--slow"]]
)
def test_bad_usage_exits_with_2(tmp_path, options):
    result = run("--out", tmp_path / "out", *options)
    assert result.exit_code == 2
    assert options[0] in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(propagation, "measure", None)
    (tmp_path / "file").touch()
    (tmp_path / "taken" / "figure-3.png").mkdir(parents=True)
    for out in (tmp_path / "file", tmp_path / "taken"):
        result = run("--out", out)
        assert result.exit_code == 1
        assert result.stderr.startswith("rtin: ")
        assert result.stderr.count("\n") == 1
        assert str(out) in result.stderr
