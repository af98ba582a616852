"""``rtin compare``, as its users meet it, and what it draws."""

import base64
import csv
import dataclasses
import io
import json
import re

import numpy as np
import pytest
from affine import Affine
from PIL import Image
from typer.testing import CliRunner

import rtin
from rtin import cli, samples, simplifiers
from rtin._commands import _console
from rtin.studies import comparison, comparison_pictures, comparison_report

HEIGHTS = samples.jacksboro_fault().heights[100:165, 40:105]
PLACE = Affine(90.0, 0.0, 5e5, 0.0, -90.0, 4e6)


def run(*arguments):
    return CliRunner().invoke(cli.app, ["compare", *map(str, arguments)])


def summary_of(*arguments):
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture(autouse=True)
def coarse_maps(monkeypatch):
    monkeypatch.setattr(comparison_pictures, "_PIXELS_OF_SAMPLES", 60)


@pytest.fixture
def files(tmp_path):
    """A raster and two meshes of it, without a CRS, in a folder of their own."""
    np.save(tmp_path / "dem.npy", HEIGHTS)
    grid = rtin.read_grid(tmp_path / "dem.npy")
    for error in (20, 60):
        rtin.write_mesh(rtin.coarsen(grid, max_error=error), tmp_path / f"{error}.ply")
    return tmp_path


def with_crs(path, crs, shift=0.0):
    place = Affine(90.0, 0.0, 5e5 + shift, 0.0, -90.0, 4e6)
    if crs == "EPSG:4326":
        place = Affine(1 / 1200, 0.0, -84.0 + shift, 0.0, -1 / 1200, 36.0)
    rtin.write_mesh(rtin.coarsen(rtin.Grid(HEIGHTS, place, crs), max_error=60.0), path)
    return path


def pictures_in(page):
    """The pictures of an HTML page, opened; the page must need nothing from elsewhere."""
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    assert "url(" not in text
    assert "<script" not in text
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    return [opened(base64.b64decode(data)) for data in found]


def opened(picture):
    return Image.open(io.BytesIO(picture)).convert("RGB")


# --- two surfaces -------------------------------------------------------------------------------


def test_the_figures_are_those_of_the_library(files):
    summary = summary_of(files / "dem.npy", files / "20.ply")
    grid, mesh = rtin.read_grid(files / "dem.npy"), rtin.read_mesh(files / "20.ply")
    expected = rtin.compare(grid, mesh)
    for name, side in (("forward", expected.forward), ("backward", expected.backward)):
        found = summary[name]
        assert found["samples"] == side.n_samples
        for key in ("max", "rms", "mean", "area_rms", "area_mean"):
            assert found[key] == getattr(side, key)
        for key, share in (("median", 0.5), ("quantile_90", 0.9), ("quantile_99", 0.99)):
            assert found[key] == side.quantile(share)
        assert tuple(found["place"]) == side.place
    assert summary["hausdorff"] == expected.hausdorff
    error = rtin.vertical_error(mesh, grid)
    assert summary["vertical"] == {
        "max": error.max, "rms": error.rms, "mean": error.mean, "uncovered_samples": 0,
        "row": error.sample[0], "col": error.sample[1],
    }  # fmt: skip
    assert summary["a"] == {
        "input": str(files / "dem.npy"), "vertices": 65 * 65, "triangles": 2 * 64 * 64,
        "bytes": (files / "dem.npy").stat().st_size,
    }  # fmt: skip
    assert summary["b"]["vertices"] == mesh.n_vertices
    assert summary["b"]["triangles"] == mesh.n_triangles
    assert "certified" not in summary


def test_what_lies_above_and_below_is_that_of_the_library(files):
    found = summary_of(files / "20.ply", files / "60.ply", "--html", files / "page.html")
    meshes = [rtin.read_mesh(files / name) for name in ("20.ply", "60.ply")]
    expected = rtin.terrain_difference(*meshes)
    told = found["b_minus_a"]
    for name in ("min", "max", "mean", "rms", "fill", "cut", "area"):
        assert told[name] == getattr(expected, name)
    assert told["normals_mean_degrees"] == expected.normals.mean
    assert told["fill"] - told["cut"] == pytest.approx(told["mean"] * told["area"])
    assert f"cut {expected.cut:.6g}" in (files / "page.html").read_text(encoding="utf-8")


def test_both_sides_may_be_meshes_and_change_places(files):
    there = summary_of(files / "20.ply", files / "60.ply")
    back = summary_of(files / "60.ply", files / "20.ply")
    assert "vertical" not in there
    assert there["forward"]["max"] == back["backward"]["max"] > 0.0
    assert there["hausdorff"] == back["hausdorff"]


def test_a_surface_is_at_no_distance_from_itself(files):
    picture = files / "out.png"
    summary = summary_of(files / "20.ply", files / "20.ply", "--picture", picture)
    assert summary["hausdorff"] < 1e-9
    assert opened(picture.read_bytes()).size[0] > 500


def test_sampling_samples_and_seed_are_passed_on(files):
    surfaces = files / "20.ply", files / "60.ply"
    corners = summary_of(*surfaces, "--sampling", "vertices")
    assert corners["forward"]["samples"] == corners["a"]["vertices"]
    drawn = [
        summary_of(*surfaces, "--sampling", "montecarlo", "--samples", 9000, "--seed", seed)
        for seed in (1, 1, 2)
    ]
    assert drawn[0]["forward"] == drawn[1]["forward"] != drawn[2]["forward"]
    assert 8000 < drawn[0]["forward"]["samples"] <= 9000


def test_certified_bounds_hold_and_are_as_near_as_asked(files):
    summary = summary_of(
        files / "dem.npy", files / "60.ply", "--certified", "--tolerance", 0.01,
    )  # fmt: skip
    bounds = summary["certified"]
    assert summary["hausdorff"] <= bounds["upper"] <= bounds["lower"] + 0.01
    assert len(bounds["place"]) == 3


def test_a_window_cuts_the_raster(files):
    window = "--window", 0, 33, 0, 17
    assert summary_of(files / "dem.npy", files / "20.ply", *window)["a"]["vertices"] == 33 * 17


def test_the_summary_without_json_has_a_line_for_each_figure(files):
    result = run(files / "dem.npy", files / "20.ply", "--certified")
    for wanted in ("A to B", "quantile 99", "largest at x", "area rms", "hausdorff", "certified"):
        assert wanted in result.stdout


def test_the_csv_has_a_row_for_each_direction(files):
    summary = summary_of(files / "dem.npy", files / "20.ply", "--csv", files / "out.csv",
                         "--certified")  # fmt: skip
    with (files / "out.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["direction"] for row in rows] == ["forward", "backward"]
    assert float(rows[1]["rms"]) == summary["backward"]["rms"]
    assert max(float(row["upper"]) for row in rows) == summary["certified"]["upper"]
    assert [float(rows[0][axis]) for axis in "xyz"] == summary["forward"]["place"]
    assert summary["written"] == [str(files / "out.csv")]


def test_the_page_opens_without_a_network_and_escapes_names(files):
    odd = files / "<b>&amp.ply"
    odd.write_bytes((files / "20.ply").read_bytes())
    summary_of(files / "dem.npy", odd, "--html", files / "out.html")
    text = (files / "out.html").read_text(encoding="utf-8")
    assert "<b>" not in text
    assert "&lt;b&gt;&amp;amp.ply" in text
    assert "Hausdorff" in text
    assert len(pictures_in(files / "out.html")) == 1


@pytest.mark.parametrize("a", ["dem.npy", "20.ply"])
@pytest.mark.parametrize("b", ["dem.npy", "60.ply"])
def test_any_two_surfaces_can_be_drawn(files, a, b):
    summary_of(files / a, files / b, "--picture", files / "out.png")
    picture = opened((files / "out.png").read_bytes())
    assert len(picture.getcolors(1 << 20)) > 8


def test_the_extension_names_the_pictures_format(files):
    summary_of(files / "dem.npy", files / "20.ply", "--picture", files / "out.svg")
    assert "<svg" in (files / "out.svg").read_text(encoding="utf-8")


# --- notes and wrong things ---------------------------------------------------------------------


@pytest.mark.parametrize("places", [(0.0, 2e4), (2e4, 0.0)])
def test_surfaces_apart_are_measured_with_a_note(tmp_path, places):
    paths = [with_crs(tmp_path / f"{x:g}.ply", None, x) for x in places]
    summary = summary_of(*paths, "--picture", tmp_path / "out.png")
    assert summary["notes"] == ["the surfaces do not overlap: are both in the same coordinates?"]
    assert summary["hausdorff"] == pytest.approx(2e4, rel=0.01)


def test_a_raster_beside_the_mesh_has_no_vertical_figures(files):
    far = with_crs(files / "far.ply", None)
    summary = summary_of(files / "dem.npy", far)
    assert not {"vertical", "b_minus_a"} & summary.keys()
    assert "do not overlap" in summary["notes"][0]


def test_scaling_degrees_is_said(tmp_path):
    paths = [with_crs(tmp_path / f"{name}.ply", "EPSG:4326") for name in "ab"]
    assert "scaled to metres" in summary_of(*paths)["notes"][0]
    paths = [with_crs(tmp_path / f"{name}.ply", "EPSG:32617") for name in "ab"]
    assert summary_of(*paths)["notes"] == []


def test_a_side_without_a_crs_is_said(tmp_path):
    paths = with_crs(tmp_path / "a.ply", "EPSG:32617"), with_crs(tmp_path / "b.ply", None)
    assert summary_of(*paths)["notes"] == ["B has no CRS: taken to be in the other's coordinates"]


def test_unlike_crs_are_a_failure_that_names_both(tmp_path):
    result = run(
        with_crs(tmp_path / "a.ply", "EPSG:32617"), with_crs(tmp_path / "b.ply", "EPSG:32616")
    )
    assert result.exit_code == 1
    assert "EPSG:32617" in result.stderr
    assert "EPSG:32616" in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_mesh_without_triangles_is_a_failure(files):
    (files / "empty.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    result = run(files / "20.ply", files / "empty.obj")
    assert result.exit_code == 1
    assert "no triangle" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["20.ply"], "got neither"),
        (["dem.npy", "20.ply", "--max-error", "5"], "got both"),
        (["dem.npy", "20.ply", "--against", "delatin"], "--against goes with --max-error"),
        (["dem.npy", "20.ply", "--match", "error"], "--match goes with --max-error"),
        (["dem.npy", "20.ply", "--tolerance", "1"], "--tolerance goes with --certified"),
        (["dem.npy", "20.ply", "--certified", "--tolerance", "0"], "more than zero"),
        (["dem.npy", "20.ply", "--sampling", "random"], "--sampling"),
        (["dem.npy", "20.ply", "--samples", "0"], "--samples"),
        (["dem.npy", "20.ply", "--seed", "-1"], "--seed"),
        (["20.ply", "--max-error", "5"], "wants a raster"),
        (["dem.npy", "--max-error", "5,x"], "apart by commas"),
        (["dem.npy", "--max-error", "-5"], "apart by commas"),
        (["dem.npy", "--max-error", "inf"], "apart by commas"),
        (["dem.npy", "--max-error", ""], "apart by commas"),
        (["dem.npy", "--max-error", "5", "--against", "quadrics"], "meshoptimizer"),
        (["dem.npy", "--max-error", "5", "--match", "bytes"], "--match"),
        (["dem.npy", "20.ply", "--html", "out.pdf"], ".html"),
        (["dem.npy", "20.ply", "--csv", "out.xlsx"], ".csv"),
        (["dem.npy", "20.ply", "--picture", "out.ply"], ".png"),
        (["dem.npy", "20.ply", "--csv", "a.csv", "--html", "a.csv"], "--html must be a file"),
    ],
)
def test_bad_usage_exits_with_2_and_says_what_was_wanted(files, monkeypatch, arguments, wanted):
    monkeypatch.chdir(files)
    before = sorted(files.iterdir())
    result = run(*arguments)
    assert result.exit_code == 2
    assert wanted in " ".join(result.stderr.replace("│", " ").split())
    assert result.stdout == ""
    assert sorted(files.iterdir()) == before


def test_a_report_is_never_written_over_an_input(files):
    page = files / "dem.html"
    result = run(page, files / "20.ply", "--html", page)
    assert result.exit_code == 2
    assert "a file of its own" in result.stderr


def test_a_place_that_cannot_be_written_is_refused_before_the_work(files, monkeypatch):
    monkeypatch.setattr(comparison, "measure_pair", None)
    result = run(files / "dem.npy", files / "20.ply", "--html", files / "none" / "out.html")
    assert result.exit_code == 1
    assert "there is no folder" in result.stderr


def test_a_missing_file_is_a_failure(files):
    result = run(files / "dem.npy", files / "none.ply")
    assert result.exit_code == 1
    assert "none.ply" in result.stderr


# --- one raster's simplified meshes -------------------------------------------------------------


def test_the_table_has_a_row_for_each_tolerance_and_simplifier(files):
    summary = summary_of(files / "dem.npy", "--max-error", "60,20", "--against",
                         "subsample, threshold,rtin")  # fmt: skip
    rows = summary["rows"]
    assert [(row["max_error"], row["name"]) for row in rows] == [
        (20, "rtin"), (20, "subsample"), (20, "threshold"),
        (60, "rtin"), (60, "subsample"), (60, "threshold"),
    ]  # fmt: skip
    grid = rtin.read_grid(files / "dem.npy")
    least = rtin.coarsen(grid, max_error=20)
    error = rtin.vertical_error(least, grid)
    assert (rows[0]["max"], rows[0]["rms"], rows[0]["mean"]) == (error.max, error.rms, error.mean)
    assert rows[0]["hausdorff"] == rtin.compare(grid, least).hausdorff
    assert rows[0]["hausdorff_lower"] is None
    assert (rows[0]["vertices"], rows[0]["triangles"]) == (least.n_vertices, least.n_triangles)
    rtin.write_mesh(least, files / "least.glb")
    assert rows[0]["bytes"] == (files / "least.glb").stat().st_size
    for row in rows:
        least_here = next(one for one in rows if one["max_error"] == row["max_error"])
        assert row["vertices"] <= least_here["vertices"]
    assert max(row["max"] for row in rows[1:3]) > 20


def test_matched_by_error_all_keep_the_tolerance(files):
    rows = summary_of(files / "dem.npy", "--max-error", 40, "--against", "threshold,subsample",
                      "--match", "error")["rows"]  # fmt: skip
    assert len(rows) == 3
    assert all(row["max"] <= 40 for row in rows)
    assert min(row["vertices"] for row in rows) == rows[0]["vertices"]


@pytest.mark.parametrize("name", comparison.VARIANTS)
def test_our_other_options_are_compared_like_simplifiers(files, name):
    rows = summary_of(files / "dem.npy", "--max-error", 40, "--against", name)["rows"]
    assert [row["name"] for row in rows] == ["rtin", name]
    assert rows[1]["vertices"] <= rows[0]["vertices"]
    assert rows[1]["rms"] < rows[0]["rms"]


def test_no_two_simplifiers_share_a_name_or_a_label():
    names = comparison.known_names()
    assert len(set(names)) == len(names)
    assert len({comparison.label_of(name) for name in names}) == len(names)
    assert set(comparison.names_in("all")) == set(names)


def test_who_is_not_installed_or_not_suited_is_passed_over_with_a_note(files, monkeypatch):
    def missing(_):
        raise simplifiers.NotInstalled("pydelatin is not installed: pip install pydelatin")

    without = dataclasses.replace(simplifiers.SIMPLIFIERS["delatin"], _begin=missing)
    monkeypatch.setitem(simplifiers.SIMPLIFIERS, "delatin", without)
    holes = HEIGHTS.copy()
    holes[3, 4] = np.nan
    np.save(files / "holes.npy", holes)
    summary = summary_of(files / "holes.npy", "--max-error", "30,60", "--against",
                         "delatin,angle-merge,subsample")  # fmt: skip
    assert [row["name"] for row in summary["rows"]] == 2 * ["rtin", "subsample"]
    first, second = summary["notes"][:2]
    assert first.startswith("delatin for 30, 60: pydelatin is not installed")
    assert second.startswith("angle-merge for 30, 60: angle-merge takes no samples without")


def test_certified_bounds_stand_in_the_table(files):
    found = "--max-error", 60, "--against", "subsample", "--certified"
    for row in summary_of(files / "dem.npy", *found)["rows"]:
        assert row["hausdorff_lower"] <= row["hausdorff_upper"] <= 1.01 * row["hausdorff"]
    assert " to " in run(files / "dem.npy", *found).stdout


def test_the_table_is_printed_for_people(files):
    result = run(files / "dem.npy", "--max-error", "20,60", "--against", "threshold")
    lines = result.stdout.splitlines()
    assert lines[0].split()[:3] == ["max", "error", "vertices"]
    assert [line.split()[0] for line in lines[1:3]] == ["20", "20"]
    assert "RTIN-Coarsening" in lines[2]


def test_the_files_of_a_table_hold_what_was_measured(files):
    out = {name: files / f"out.{name}" for name in ("csv", "html", "png")}
    summary = summary_of(
        files / "dem.npy", "--max-error", "20,60", "--against", "threshold,subsample",
        "--csv", out["csv"], "--html", out["html"], "--picture", out["png"],
    )  # fmt: skip
    with out["csv"].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["rms"]) for row in rows] == [row["rms"] for row in summary["rows"]]
    assert list(rows[0]) == list(summary["rows"][0])
    assert len(pictures_in(out["html"])) == 5
    text = out["html"].read_text(encoding="utf-8")
    for row in summary["rows"]:
        assert f"<td>{row['vertices']:,}</td>" in text
    assert "least RTIN" in text
    assert opened(out["png"].read_bytes()).size[0] > 900
    assert summary["written"] == [str(path) for path in out.values()]


def test_a_lossless_tolerance_is_drawn_too(files):
    summary = summary_of(files / "dem.npy", "--max-error", 0, "--html", files / "out.html")
    assert summary["rows"][0]["max"] == 0.0
    assert len(pictures_in(files / "out.html")) == 3


# --- what is drawn ------------------------------------------------------------------------------


def test_of_each_block_the_value_farthest_from_zero_is_drawn():
    values = np.array([[1.0, -3.0, 2.0], [np.nan, 2.0, np.nan], [np.nan, np.nan, -0.5]])
    found = comparison_pictures._largest_of_blocks(values, 2)
    np.testing.assert_array_equal(found, [[-3.0, 2.0], [np.nan, -0.5]])
    np.testing.assert_array_equal(comparison_pictures._largest_of_blocks(values, 1), values)


def test_a_map_of_distances_has_its_largest_where_a_spike_is():
    flat = np.zeros((33, 33), np.float32)
    spike = flat.copy()
    spike[8, 20] = 10.0
    pixels, place = comparison_pictures._largest_by_place(
        rtin.Grid(spike, PLACE), rtin.Grid(flat, PLACE)
    )
    row, col = np.unravel_index(np.nanargmax(pixels), pixels.shape)
    x, y = place.a * col + place.c, place.e * row + place.f
    assert np.nanmax(pixels) == pytest.approx(10.0)
    assert abs(x - (5e5 + 20 * 90.0)) < 50.0
    assert abs(y - (4e6 - 8 * 90.0)) < 50.0
    assert not np.isnan(pixels).any()


def test_tables_of_pages_escape_their_cells():
    assert "&lt;i&gt;" in comparison_report.page.table(["<i>"], [["<i>"]])


# --- progress -----------------------------------------------------------------------------------


def test_what_lasts_says_what_share_is_done(capsys, monkeypatch):
    monkeypatch.setattr(_console, "_QUIET_SECONDS", 0.0)
    monkeypatch.setattr(_console, "_SECONDS_BETWEEN_LINES", -1.0)
    with _console.progress_bar("measuring") as tell:
        while "measuring: 50 %" not in (shown := capsys.readouterr().err):
            tell(0.5)
    assert shown.splitlines()[-1] == "rtin: measuring: 50 %, about 0 s left"


def test_what_is_quick_says_nothing(capsys):
    with _console.progress_bar("measuring") as tell:
        tell(0.5)
    assert capsys.readouterr().err == ""
