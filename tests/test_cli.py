"""The command line, as its users meet it."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import rtin
from rtin import cli, samples
from rtin._commands import _console


@pytest.fixture
def dem(tmp_path):
    path = tmp_path / "dem.npy"
    np.save(path, samples.jacksboro_fault().heights[:129, :129])
    return path


def run(*arguments):
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def test_coarsen_writes_a_mesh_and_reports_the_error_it_really_has(dem, tmp_path):
    out = tmp_path / "out.ply"
    result = run("coarsen", dem, out, "--max-error", 30, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    grid = rtin.read_grid(dem)
    mesh = rtin.read_mesh(out)
    error = rtin.vertical_error(mesh, grid)
    assert summary["achieved"] == {"max_error": error.max, "rms": error.rms, "mean": error.mean}
    assert summary["asked"] == {"max_error": 30}
    assert (summary["rows"], summary["cols"], summary["samples"]) == (129, 129, 129 * 129)
    assert (summary["vertices"], summary["triangles"]) == (mesh.n_vertices, mesh.n_triangles)
    assert summary["bytes"] == out.stat().st_size
    assert 0 < error.max <= 30


@pytest.mark.parametrize("option", ["--max-vertices", "--max-triangles"])
def test_coarsen_keeps_a_budget(dem, tmp_path, option):
    result = run("coarsen", dem, tmp_path / "out.glb", option, 700, "--json")
    summary = json.loads(result.stdout)
    assert 300 < summary[option[6:]] <= 700


@pytest.mark.parametrize("option", ["--max-vertices", "--max-triangles", "--weight"])
def test_coarsen_takes_a_norm(dem, tmp_path, option):
    result = run("coarsen", dem, tmp_path / "out.glb", "--norm", "rms", option, 700, "--json")
    summary, name = json.loads(result.stdout), option[2:].replace("-", "_")
    expected = rtin.coarsen(rtin.read_grid(dem), norm="rms", **{name: 700})
    assert summary["vertices"] == expected.n_vertices
    assert summary["asked"] == {name: 700, "norm": "rms"}


def test_coarsen_takes_the_threshold_of_the_paper(dem, tmp_path):
    result = run("coarsen", dem, tmp_path / "out.glb", "--threshold", 30, "--json")
    summary = json.loads(result.stdout)
    expected = rtin.coarsen(rtin.read_grid(dem), threshold=30)
    assert summary["vertices"] == expected.n_vertices


def test_coarsen_lets_squares_change_their_diagonals(dem, tmp_path):
    options = ("--max-error", 30, "--diagonals", "best", "--json")
    summary = json.loads(run("coarsen", dem, tmp_path / "out.glb", *options).stdout)
    expected = rtin.coarsen(rtin.read_grid(dem), max_error=30, diagonals="best")
    assert summary["asked"] == {"max_error": 30, "diagonals": "best"}
    assert summary["vertices"] == expected.n_vertices


def test_the_summary_without_json_is_for_people(dem, tmp_path):
    result = run("coarsen", dem, tmp_path / "out.glb", "--max-error", 30)
    assert "16 641" in result.stdout
    assert "max error 30" in result.stdout


def test_a_base_makes_a_watertight_solid(dem, tmp_path):
    out = tmp_path / "out.stl"
    assert run("coarsen", dem, out, "--max-error", 30, "--base", 10).exit_code == 0
    assert trimesh.load(out).is_watertight


def test_a_window_cuts_rows_and_columns(dem, tmp_path):
    out = tmp_path / "out.ply"
    options = ("--max-error", 30, "--window", 0, 33, 64, 129, "--json")
    summary = json.loads(run("coarsen", dem, out, *options).stdout)
    assert (summary["rows"], summary["cols"]) == (33, 65)


def test_scaling_degrees_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr("rtin.io.grids.read_grid", lambda *_, **__: samples.topobathy())
    result = run("coarsen", "dem.tif", tmp_path / "out.glb", "--max-error", 300)
    assert "degrees to metres" in result.stdout
    result = run("coarsen", "dem.tif", tmp_path / "out.glb", "--max-error", 300, "--keep-degrees")
    assert "degrees to metres" not in result.stdout


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ([], "exactly one of --max-error"),
        (["--max-error", "5", "--threshold", "5"], "got --max-error and --threshold"),
        (["--max-error", "-5"], "zero or more, got -5"),
        (["--max-error", "nan"], "zero or more, got nan"),
        (["--max-error", "much"], "--max-error"),
        (["--max-error", "5", "--z-scale", "0"], "--z-scale must be more than zero"),
        (["--max-error", "5", "--base", "-1"], "--base must be more than zero"),
        (["--max-error", "5", "--band", "0"], "--band"),
        (["--max-error", "5", "--diagonals", "longest"], "--diagonals"),
        (["--max-error", "5", "--window", "0", "5"], "--window"),
        (["--max-triangles", "1.5"], "--max-triangles"),
        (["--max-error", "5", "--fast"], "--fast"),
        (["--max-error", "5", "--norm", "rms"], "goes with --max-vertices, --max-triangles or"),
        (["--weight", "5"], "--weight goes with --norm rms"),
        (["--max-vertices", "5", "--norm", "l2"], "--norm"),
    ],
)
def test_bad_usage_exits_with_2_and_says_what_was_wanted(dem, tmp_path, options, wanted):
    out = tmp_path / "out.glb"
    result = run("coarsen", dem, out, *options)
    assert result.exit_code == 2
    assert wanted in result.stderr
    assert result.stdout == ""
    assert not out.exists()


def test_an_unknown_extension_is_bad_usage(dem, tmp_path):
    result = run("coarsen", dem, tmp_path / "out.xyz", "--max-error", 5)
    assert result.exit_code == 2
    assert ".glb" in result.stderr


@pytest.mark.parametrize(
    ("name", "options", "wanted"),
    [
        ("missing.tif", [], "missing.tif"),
        ("text.tif", [], "text.tif"),
        ("dem.npy", ["--band", "2"], "band"),
        ("dem.npy", ["--window", "0", "500", "0", "500"], "129"),
        ("dem.npy", ["--max-triangles", "1"], "max_triangles"),
    ],
)
def test_a_failure_is_one_line_with_exit_code_1(dem, tmp_path, monkeypatch, name, options, wanted):
    monkeypatch.setattr(_console, "_QUIET_SECONDS", 1000.0)  # on however slow a machine
    (tmp_path / "text.tif").write_text("not a raster")
    tolerance = [] if "--max-triangles" in options else ["--max-error", "5"]
    result = run("coarsen", tmp_path / name, tmp_path / "out.glb", *tolerance, *options)
    assert result.exit_code == 1
    assert wanted in result.stderr
    assert result.stderr.startswith("rtin: ")
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out.glb").exists()


def test_a_missing_folder_is_refused_before_the_work(dem, tmp_path):
    result = run("coarsen", tmp_path / "missing.tif", tmp_path / "no" / "out.glb", "--max-error", 5)
    assert result.exit_code == 1
    assert "there is no folder" in result.stderr


def test_info_describes_a_raster_and_points_out_a_suspicious_value(tmp_path):
    heights = np.ones((5, 5), np.float32)
    heights[1, :3] = -9999
    np.save(tmp_path / "dem.npy", heights)
    summary = json.loads(run("info", tmp_path / "dem.npy", "--json").stdout)
    assert (summary["rows"], summary["cols"], summary["voids"]) == (5, 5, 0)
    assert (summary["lowest"], summary["highest"]) == (-9999, 1)
    assert any("-9999" in line for line in summary["suspicious"])


def test_info_describes_a_mesh_and_its_complaints(tmp_path):
    corners = [[0, 0, 0], [2, 0, 0], [2, 2, 5], [0, 2, 0], [1, 1, 9]]
    hanging = rtin.TriangleMesh(corners, [[0, 2, 3], [0, 1, 4], [1, 2, 4]])
    rtin.write_mesh(hanging, tmp_path / "mesh.ply")
    summary = json.loads(run("info", tmp_path / "mesh.ply", "--json").stdout)
    assert (summary["vertices"], summary["triangles"]) == (5, 3)
    assert (summary["from"], summary["to"]) == ([0, 0, 0], [2, 2, 9])
    assert any("hang" in line for line in summary["complaints"])


def test_plot_draws_a_mesh_over_its_raster(dem, tmp_path):
    run("coarsen", dem, tmp_path / "mesh.ply", "--max-error", 30)
    result = run("plot", tmp_path / "mesh.ply", tmp_path / "mesh.png", "--dem", dem)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "mesh.png").read_bytes().startswith(b"\x89PNG")


def test_plot_refuses_an_unknown_extension_before_it_reads(tmp_path):
    result = run("plot", tmp_path / "missing.ply", tmp_path / "mesh.xyz")
    assert result.exit_code == 2
    assert ".png" in result.stderr


def test_demo_leaves_three_files_to_look_at(tmp_path):
    result = run("demo", tmp_path / "demo", "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    files = sorted(path.name for path in (tmp_path / "demo").iterdir())
    assert files == ["terrain.glb", "terrain.html", "terrain.png"]
    assert summary["achieved"]["max_error"] <= summary["asked"]["max_error"]
    assert summary["samples"] == 344 * 403


def test_progress_is_told_on_stderr_and_only_when_it_takes_long(dem, tmp_path, monkeypatch):
    quiet = run("coarsen", dem, tmp_path / "out.glb", "--max-error", 30)
    assert "coarsening" not in quiet.stderr
    monkeypatch.setattr(_console, "_QUIET_SECONDS", 0.0)
    told = run("coarsen", dem, tmp_path / "out.glb", "--max-error", 1, "--json")
    assert "coarsening 129 × 129 samples" in told.stderr
    assert json.loads(told.stdout)


@pytest.mark.parametrize(("target", "message"), [("| true", ""), ("> /dev/full", "stdout")])
@pytest.mark.parametrize("command", ["info {dem}", "info {dem} --json", "--help"])
def test_a_summary_that_nobody_takes_is_a_failure_of_one_line(dem, command, target, message):
    command = (
        f"{sys.executable} -m rtin {command.format(dem=dem)} {target}; exit ${{PIPESTATUS[0]}}"
    )
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    result = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False, env=environment
    )
    assert result.returncode == 1
    assert message in result.stderr
    assert result.stderr.count("\n") == (1 if message else 0), result.stderr


def test_the_raster_itself_is_no_output(dem, tmp_path):
    link = tmp_path / "out.ply"
    link.symlink_to(dem)
    before = dem.read_bytes()
    result = run("coarsen", dem, link, "--max-error", 5)
    assert result.exit_code == 2
    assert "must not be the raster itself" in result.stderr
    assert dem.read_bytes() == before


def test_an_absurd_budget_is_no_traceback(dem, tmp_path):
    result = run("coarsen", dem, tmp_path / "out.glb", "--max-triangles", 10**20, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["achieved"]["max_error"] == 0


def test_json_holds_no_infinite_number(dem, tmp_path):
    result = run("coarsen", dem, tmp_path / "out.glb", "--max-error", "inf", "--json")
    assert json.loads(result.stdout)["asked"] == {"max_error": None}
    assert "Infinity" not in result.stdout


def test_an_unexpected_failure_is_one_line_too(dem, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr("rtin.io.grids.read_grid", fail)
    result = run("coarsen", dem, tmp_path / "out.glb", "--max-error", 5)
    assert (result.exit_code, result.stderr) == (1, "rtin: ZeroDivisionError: division by zero\n")


def test_coarsen_points_out_undeclared_nodata_and_a_missing_crs(tmp_path):
    heights = np.random.default_rng(0).random((9, 9)).astype(np.float32)
    heights[4, 4] = -9999
    np.save(tmp_path / "dem.npy", heights)
    options = ("--max-error", 1, "--json")
    notes = json.loads(run("coarsen", tmp_path / "dem.npy", tmp_path / "o.glb", *options).stdout)
    assert any("-9999 in 1 sample" in note for note in notes["notes"])
    assert any("no CRS" in note for note in notes["notes"])


@pytest.mark.parametrize("compiled", [True, False])
def test_the_first_run_says_that_it_compiles(dem, tmp_path, monkeypatch, compiled):
    monkeypatch.setattr("rtin.coarsening.is_compiled", lambda: compiled)
    result = run("coarsen", dem, tmp_path / "out.glb", "--max-error", 30)
    assert ("first run: compiling" in result.stderr) is not compiled


def test_info_knows_a_solid(dem, tmp_path):
    run("coarsen", dem, tmp_path / "solid.stl", "--max-error", 30, "--base", 10)
    summary = json.loads(run("info", tmp_path / "solid.stl", "--json").stdout)
    assert summary["solid"] is True
    assert summary["complaints"] == []


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["coarsen", "--help"], ["study", "propagation", "-h"]]
)
def test_help_and_version_do_not_wait_for_heavy_imports(arguments):
    code = (
        "import sys; from rtin.cli import app\n"
        f"try: app({arguments!r})\n"
        "except SystemExit as stop: assert not stop.code\n"
        "heavy = {'numba', 'numpy', 'rasterio', 'trimesh', 'matplotlib', 'pyproj', 'rich'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith(("Usage", "rtin "))


def test_importing_the_package_does_not_import_numba():
    code = "import rtin, sys; rtin.Grid; rtin.coarsen; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- refine -------------------------------------------------------------------------------------


@pytest.fixture
def coarse(dem, tmp_path):
    path = tmp_path / "coarse.ply"
    rtin.write_mesh(rtin.coarsen(rtin.read_grid(dem), max_error=100), path)
    return path


def refined(coarse, tmp_path, *options):
    out = tmp_path / "fine.ply"
    result = run("refine", coarse, out, *options, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    mesh = rtin.read_mesh(out)
    assert (summary["vertices"], summary["triangles"]) == (mesh.n_vertices, mesh.n_triangles)
    assert summary["before"]["triangles"] == rtin.read_mesh(coarse).n_triangles
    return mesh, summary


@pytest.mark.parametrize("scheme", ["4T-LE", "4T-SS", "bisection"])
def test_refine_where_a_condition_holds(coarse, tmp_path, scheme):
    before = rtin.read_mesh(coarse)
    high = before.vertices[before.triangles, 2].mean(axis=1) > 600
    mesh, _ = refined(coarse, tmp_path, "--where", "z > 600", "--scheme", scheme)
    np.testing.assert_array_equal(mesh.triangles, rtin.refine(before, high, scheme).triangles)


def test_refine_asks_again_as_often_as_wanted(coarse, tmp_path):
    mesh, _ = refined(coarse, tmp_path, "--where", "area > 50", "--times", 20)
    assert mesh.signed_areas().max() <= 50
    assert mesh.signed_areas().sum() == 128 * 128


def test_refine_takes_a_list_of_triangles(coarse, tmp_path):
    (tmp_path / "list.txt").write_text("0 5\n7")
    mesh, _ = refined(coarse, tmp_path, "--triangles", tmp_path / "list.txt")
    assert mesh.n_triangles == rtin.refine(rtin.read_mesh(coarse), [0, 5, 7]).n_triangles


def test_refine_uniformly_and_take_heights_from_a_raster(coarse, dem, tmp_path):
    before, grid = rtin.read_mesh(coarse), rtin.read_grid(dem)
    mesh, summary = refined(coarse, tmp_path, "--uniform", 2, "--dem", dem)
    assert mesh.n_triangles == 16 * before.n_triangles
    np.testing.assert_array_equal(mesh.vertices[:, 2], grid.heights_at(mesh.vertices[:, :2]))
    assert summary["achieved"]["max_error"] == rtin.vertical_error(mesh, grid).max


def test_refine_until_the_mesh_fits_a_raster(coarse, dem, tmp_path):
    _, summary = refined(coarse, tmp_path, "--max-error", 10, "--dem", dem)
    assert 0 < summary["achieved"]["max_error"] <= 10
    assert summary["asked"] == {"max_error": 10}
    _, by_threshold = refined(coarse, tmp_path, "--threshold", 10, "--dem", dem)
    assert summary["before"]["vertices"] < by_threshold["vertices"]


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ([], 2, "exactly one of --where, --triangles, --uniform, --max-error, --threshold"),
        (["--uniform", 1, "--where", "z > 1"], 2, "got --where and --uniform"),
        (["--uniform", -1], 2, "--uniform"),
        (["--max-error", 5], 2, "--max-error wants a raster to fit: --dem DEM"),
        (["--threshold", 5], 2, "--threshold wants a raster to fit: --dem DEM"),
        (["--uniform", 2, "--times", 2], 2, "--times goes with --where"),
        (["--where", "import os"], 2, "a condition such as 'z > 100' is wanted"),
        (["--where", "height > 3"], 2, "cannot use 'height' in a condition"),
        (["--triangles", "missing.txt"], 1, "missing.txt: No such file"),
        (["--uniform", 1, "--scheme", "4t"], 2, "--scheme"),
    ],
)
def test_wrong_ways_to_refine_end_in_one_line_and_write_nothing(
    coarse, tmp_path, options, code, message
):
    out = tmp_path / "fine.ply"
    result = run("refine", coarse, out, *options)
    assert result.exit_code == code
    assert message in " ".join(result.output.split())
    assert not out.exists()


def test_a_list_with_triangles_that_are_not_there_fails(coarse, tmp_path):
    (tmp_path / "list.txt").write_text("1000000")
    result = run("refine", coarse, tmp_path / "fine.ply", "--triangles", tmp_path / "list.txt")
    assert result.exit_code == 1
    assert "numbered from 0; got 1000000" in result.output


def test_a_mesh_that_is_not_conforming_is_refused_with_its_fault(tmp_path):
    points = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]]
    hanging = rtin.TriangleMesh.from_triangles(points, [[0, 1, 2], [0, 4, 3], [4, 2, 3]])
    rtin.write_mesh(hanging, tmp_path / "hanging.ply")
    result = run("refine", tmp_path / "hanging.ply", tmp_path / "out.ply", "--uniform", 1)
    assert result.exit_code == 1
    assert "vertex 4 hangs inside edge 0-2 of triangle 0, at (1, 1)" in result.output


def test_heights_from_a_raster_do_not_need_a_sample_under_the_mesh(dem, tmp_path):
    inside_a_cell = rtin.TriangleMesh.from_triangles(
        [[5.2, -5.2, 0], [5.8, -5.2, 0], [5.5, -5.8, 0]], [[0, 1, 2]]
    )
    rtin.write_mesh(inside_a_cell, tmp_path / "small.ply")
    out = tmp_path / "out.ply"
    result = run("refine", tmp_path / "small.ply", out, "--uniform", 1, "--dem", dem, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["achieved"].startswith("unknown")
    assert rtin.read_mesh(out).n_triangles == 4


def test_more_triangles_than_can_be_numbered_are_refused_before_they_are_made(coarse, tmp_path):
    result = run("refine", coarse, tmp_path / "out.ply", "--uniform", 20)
    assert result.exit_code == 2
    assert "--uniform 20 would make more than the" in " ".join(result.output.split())


def test_a_mesh_that_went_through_32_bits_is_refined_like_the_one_it_was(tmp_path):
    """In degrees, where a GLB moves vertices by a ten-thousandth of a cell."""
    grid = samples.topobathy()
    coarse = rtin.coarsen(grid, max_error=400)
    rtin.write_mesh(coarse, tmp_path / "coarse.glb")
    back = rtin.read_mesh(tmp_path / "coarse.glb")
    assert (back.vertices != coarse.vertices).any()
    for scheme in ("bisection", "4T-LE"):
        fitted = rtin.refine_to(back, grid, max_error=100, scheme=scheme)
        wanted = rtin.refine_to(coarse, grid, max_error=100, scheme=scheme)
        assert fitted.triangles.tobytes() == wanted.triangles.tobytes()
        assert rtin.vertical_error(fitted, grid).n_uncovered == 0


def test_a_mesh_without_a_crs_beside_its_raster_is_doubted(tmp_path, monkeypatch):
    monkeypatch.setattr("rtin.io.grids.read_grid", lambda *_, **__: samples.topobathy())
    mesh = rtin.coarsen(samples.topobathy(), max_error=2000)
    shifted = rtin.TriangleMesh(np.add(mesh.vertices, (10, 0, 0)), mesh.triangles)
    rtin.write_mesh(shifted, tmp_path / "shifted.ply")
    options = ("--uniform", 0, "--dem", "dem.tif", "--json")
    result = run("refine", tmp_path / "shifted.ply", tmp_path / "out.ply", *options)
    notes = json.loads(result.stdout)["notes"]
    assert any("the mesh has no CRS: taken to be in the raster's, EPSG:4326" in n for n in notes)
    assert any("vertices lie beside the raster" in note for note in notes)


def test_a_mesh_in_another_crs_than_the_raster_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("rtin.io.grids.read_grid", lambda *_, **__: samples.topobathy())
    mesh = rtin.coarsen(samples.topobathy(), max_error=2000)
    other = rtin.TriangleMesh(mesh.vertices, mesh.triangles, "EPSG:2056")
    rtin.write_mesh(other, tmp_path / "other.ply")
    out = tmp_path / "out.ply"
    result = run("refine", tmp_path / "other.ply", out, "--max-error", 100, "--dem", "dem.tif")
    assert result.exit_code == 1
    assert "the mesh is in EPSG:2056, the raster in EPSG:4326; reproject" in result.output
    assert not out.exists()


def test_a_closed_solid_is_refused_as_what_it_is(dem, tmp_path):
    solid = tmp_path / "solid.stl"
    run("coarsen", dem, solid, "--max-error", 100, "--base", 10)
    result = run("refine", solid, tmp_path / "out.stl", "--uniform", 1)
    assert result.exit_code == 1
    assert "the mesh is a closed solid; refine the terrain before it gets a --base" in result.output


def test_that_nothing_was_chosen_is_said(coarse, tmp_path):
    _, summary = refined(coarse, tmp_path, "--where", "z > 1e9")
    assert summary["notes"][0] == "no triangle was chosen: the mesh is as before"


def test_info_lists_tags(tmp_path):
    mesh = rtin.TriangleMesh.from_triangles(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], tags=[7, 8]
    )
    rtin.write_mesh(mesh, tmp_path / "tagged.2dm")
    summary = json.loads(run("info", tmp_path / "tagged.2dm", "--json").stdout)
    assert summary["tags"] == ["7 (1 triangles)", "8 (1 triangles)"]


# Swallows Ctrl-C, as trimesh does with whatever ends the import of what it can do without.
SLOW_IMPORT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from rtin import cli

class Swallows:
    def find_spec(self, name, path, target=None):
        if name == "trimesh":
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except BaseException:
                pass

sys.meta_path.insert(0, Swallows())
sys.argv = ["rtin", "refine", sys.argv[1], sys.argv[2], "--uniform", "1"]
cli.main()
"""


def test_ctrl_c_is_not_lost_while_libraries_are_imported(coarse, tmp_path):
    out = tmp_path / "out.ply"
    command = [sys.executable, "-c", SLOW_IMPORT, str(coarse), str(out)]
    result = subprocess.run(command, capture_output=True, check=False)
    assert result.returncode == 130, result.stderr
    assert not out.exists()
