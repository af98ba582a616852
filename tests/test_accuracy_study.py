"""The study of accuracy: the paper's Tables 1 to 3, figures 5 and 6, and how they are repeated."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from typer.testing import CliRunner

import rtin
import terrains
from rtin import cli, samples, simplifiers, validity
from rtin.studies import accuracy, accuracy_pictures

REPRODUCE = Path(__file__).parent.parent / "reproduce"
PNG = b"\x89PNG"


def part_of_jacksboro(rows, cols):
    grid = samples.jacksboro_fault()
    return rtin.Grid(grid.heights[:rows, :cols], grid.transform, grid.crs)


@pytest.fixture(scope="module")
def study():
    return accuracy.measure(part_of_jacksboro(65, 65))


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.npy"
    np.save(path, part_of_jacksboro(33, 33).heights)
    return path


def run(*arguments):
    return CliRunner().invoke(cli.app, ["study", "accuracy", *map(str, arguments)])


# --- the paper ----------------------------------------------------------------------------------


def test_the_papers_tables_are_as_printed():
    assert [row.n_vertices for row in accuracy.TABLE_1] == [5750, 1975, 1094]
    assert [row.n_vertices for row in accuracy.TABLE_2] == [5741, 1978, 1079]
    assert accuracy.TABLE_1[1].metro == (0.011615, 0.088699, 0.006760, 0.127386)
    assert accuracy.TABLE_2[0].metro == (0.489856, 0.906838, 0.421390, 0.906838)
    for row in (*accuracy.TABLE_1, *accuracy.TABLE_2):
        assert row.metro.mean < row.metro.rms < row.metro.max <= row.metro.hausdorff


def test_figure_5_of_the_paper_is_a_disc_by_eulers_formula():
    n_border = 2 * accuracy.FIGURE_5["n_vertices"] - accuracy.FIGURE_5["n_triangles"] - 2
    assert 4 <= n_border <= 4 * 64


# --- what is measured ---------------------------------------------------------------------------


def test_the_paper_s_shares_of_the_samples_are_asked_for(study):
    assert [row.asked for row in accuracy.rows_of(study, "rtin")] == [368, 126, 70]
    shares = [row.n_vertices / 257**2 * 65**2 for row in accuracy.TABLE_1]
    assert [round(share) for share in shares] == [368, 126, 70]


def test_figures_are_those_of_the_meshes(study):
    for row in study.rows:
        validity.check(row.made.mesh)
        assert row.figures.n_vertices == row.made.mesh.n_vertices <= row.asked
        assert row.figures.max == rtin.vertical_error(row.made.mesh, study.grid).max
        found = rtin.compare(study.grid, row.made.mesh)
        assert row.metro.rms == found.forward.rms
        assert row.metro.max == found.forward.max
        assert row.metro.mean == found.forward.mean
        assert row.metro.hausdorff == found.hausdorff
        # No point of the terrain is farther away than what lies above or below it.
        assert row.metro.max <= row.figures.max * (1.0 + 1e-9)


def test_the_least_mesh_has_the_smallest_largest_error(study):
    for by_threshold, least in zip(
        accuracy.rows_of(study, "threshold"), accuracy.rows_of(study, "rtin"), strict=True
    ):
        assert least.figures.max < by_threshold.figures.max


def test_the_papers_claim_holds_on_jacksboro_with_what_stands_in(study):
    lines = accuracy.verdict(study)
    assert lines[-2].endswith("holds on this terrain.")
    assert "73 ×, 22 ×, 13 ×" in lines[-1]
    assert len(lines) == 5
    ours, theirs = (accuracy.rows_of(study, name)[0] for name in ("threshold", "angle-merge"))
    assert f"RMS {theirs.metro.rms / ours.metro.rms:.2f} ×" in lines[0]


def test_the_claim_is_counted_where_it_does_not_hold(study):
    turned = [
        accuracy.Row(row.asked, row.made, row.figures._replace(name=name), row.metro)
        for row in study.rows
        for name in {"threshold": ["angle-merge"], "angle-merge": ["threshold"]}.get(
            row.figures.name, []
        )
    ]
    changed = accuracy.Study(
        study.grid, study.relief, study.spread, turned, study.at_thresholds, []
    )
    assert accuracy.verdict(changed)[-2].endswith("holds in 0 of 12 figures on this terrain.")


def test_thresholds_are_the_papers_and_those_that_its_counts_take(study):
    for threshold, count in study.at_thresholds.items():
        assert count == rtin.coarsen(study.grid, threshold=threshold).n_vertices
    assert list(study.at_thresholds) == [30.0, 60.0, 90.0]
    text = accuracy.as_text(study)
    for row in accuracy.rows_of(study, "threshold"):
        assert f"threshold {row.made.setting:.4g}" in text


def test_what_can_not_take_the_terrain_is_noted():
    heights = np.array(part_of_jacksboro(65, 65).heights)
    heights[:2, :2] = np.nan
    found = accuracy.measure(rtin.Grid(heights), ["rtin", "angle-merge"])
    assert {row.figures.name for row in found.rows} == {"rtin"}
    assert len(found.notes) == 3
    assert "angle-merge" in found.notes[0]
    assert found.notes[0] in accuracy.as_text(found)
    assert accuracy.verdict(found) == []


def test_the_close_up_is_the_part_with_the_most_relief():
    heights = np.zeros((150, 200))
    heights[70:75, 130:140] = np.arange(50.0).reshape(5, 10)
    grid = rtin.Grid(heights, Affine(2.0, 0, 100.0, 0, -2.0, 50.0))
    close = accuracy.close_up(grid)
    assert close.grid.shape == (65, 65)
    assert np.array_equal(close.grid.heights, heights[64:129, 128:193])
    assert tuple(close.grid.transform)[:6] == (2.0, 0.0, 356.0, 0.0, -2.0, -78.0)
    assert close.at_count.mesh.n_vertices <= 1588
    assert close.at_threshold.n_vertices == rtin.coarsen(close.grid, threshold=15.0).n_vertices


@pytest.mark.parametrize(
    ("heights", "message"),
    [(np.zeros((40, 40)), "some relief"), (terrains.waves((12, 12)), "242 samples or more")],
)
def test_a_terrain_that_shows_nothing_is_refused(heights, message):
    with pytest.raises(ValueError, match=message):
        accuracy.measure(rtin.Grid(heights))


def test_242_samples_are_enough():
    assert accuracy.measure(rtin.Grid(terrains.waves((11, 22))), ["subsample"]).rows


# --- tables and pictures ------------------------------------------------------------------------


def test_the_table_has_the_papers_figures_beside_ours(study):
    lines = accuracy.as_text(study).splitlines()
    for published in (*accuracy.TABLE_1, *accuracy.TABLE_2):
        (line,) = (line for line in lines if published.label in line)
        assert f"{published.n_vertices}  {published.metro.rms:.5f}" in line
    for row in study.rows:
        assert any(f"{row.metro.rms / study.relief:.5f}" in line for line in lines)


def test_the_table_of_times_has_the_papers_seconds(study):
    lines = accuracy.times_as_text(study).splitlines()
    assert len(lines) == 1 + len(study.rows)
    for name, seconds in accuracy.SECONDS.items():
        label = simplifiers.SIMPLIFIERS[name].label
        shown = [line.split()[-2] for line in lines if line.startswith(label)]
        assert shown == [f"{value:.3f}" for value in seconds]


def test_pictures_are_written_whole(study, tmp_path):
    written = accuracy_pictures.write_pictures(study, tmp_path)
    written.append(accuracy_pictures.write_figure_5(accuracy.close_up(study.grid), tmp_path))
    assert sorted(tmp_path.iterdir()) == sorted(written)
    for path in written:
        assert path.read_bytes().startswith(PNG)
        assert 5_000 < path.stat().st_size < 500_000


# --- the command line and the scripts -----------------------------------------------------------


def test_the_command_prints_the_tables_and_says_where_the_pictures_are(dem, tmp_path):
    out = tmp_path / "new" / "folder"
    result = run(dem, "--out", out)
    assert result.exit_code == 0, result.output
    assert "the paper's RTIN-30" in result.stdout
    assert "RTIN-Coarsening is the more accurate" in result.stdout
    for name in ("figure-5.png", "figure-6.png", "errors.png"):
        assert str(out / name) in result.stdout
        assert (out / name).read_bytes().startswith(PNG)


def test_the_command_gives_json_and_takes_more_simplifiers(dem, tmp_path):
    result = run(dem, "--out", tmp_path, "--against", "subsample, rtin", "--json")
    summary = json.loads(result.stdout)
    names = [row["name"] for row in summary["rows"]]
    assert names == ["threshold", "rtin", "angle-merge", "subsample"] * 3
    row = summary["rows"][0]
    assert row["n_vertices"] <= row["asked"] == 95
    assert set(row["metro"]) == {"rms", "max", "mean", "hausdorff"}
    assert row["tolerance"] > 0.0
    assert set(summary["at_thresholds"]) == {"30", "60", "90"}
    assert len(summary["written"]) == 3


def test_an_unknown_simplifier_is_bad_usage(tmp_path):
    result = run("--against", "martini,magic", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "magic" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_missing_raster_and_a_folder_that_cannot_be_written_fail_in_one_line(dem, tmp_path):
    (tmp_path / "file").touch()
    for result in (
        run(tmp_path / "none.tif", "--out", tmp_path / "out"),
        run(dem, "--out", tmp_path / "file"),
    ):
        assert result.exit_code == 1
        assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["table_1", "table_2", "table_3", "figure_5", "figure_6"])
def test_the_script_runs(name, dem, tmp_path, capsys):
    spec = importlib.util.spec_from_file_location(name, REPRODUCE / f"{name}.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    folder = [str(tmp_path / "pictures")] if name.startswith("figure") else []
    script.main(*folder, str(dem))
    printed = capsys.readouterr().out
    wanted = {
        "table_1": "the paper's RTIN-90",
        "table_2": "the paper's RR-98.45%",
        "table_3": "4.203",
        "figure_5": "1588 vertices, 3063 triangles",
        "figure_6": "figure-6.png",
    }
    assert wanted[name] in printed
