"""`fit_heights` and `coarsen(heights="fitted")`: least squares, and what is promised as well."""

import json
from fractions import Fraction

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import meshes
import naive
import rtin
import terrains
from rtin.cli import app
from rtin.mesh import TriangleMesh


def z_of(mesh):
    return mesh.vertices[:, 2]


def sum_of_squares(mesh, grid):
    return float(np.nansum(naive.surface_minus_samples(mesh, grid) ** 2))


def with_heights(mesh, z):
    return TriangleMesh(np.column_stack([mesh.vertices[:, :2], z]), mesh.triangles, mesh.crs)


# --- least squares ------------------------------------------------------------------------------


@given(terrains.rasters(), terrains.tolerances)
def test_is_the_least_squares_solution(heights, threshold):
    grid = rtin.Grid(heights)
    mesh = rtin.coarsen(grid, threshold=threshold)
    fitted = rtin.coarsen(grid, threshold=threshold, heights="fitted")
    np.testing.assert_allclose(z_of(fitted), naive.least_squares_heights(mesh, grid), atol=1e-8)


@pytest.mark.parametrize("name", terrains.TRANSFORMS)
def test_is_the_same_wherever_the_raster_lies(name):
    heights = terrains.waves((17, 23))
    mesh = rtin.coarsen(rtin.Grid(heights), max_vertices=120, heights="fitted")
    moved = rtin.Grid(heights, terrains.TRANSFORMS[name])
    elsewhere = rtin.coarsen(moved, max_vertices=120, heights="fitted")
    np.testing.assert_allclose(z_of(elsewhere), z_of(mesh), atol=1e-8)


@given(st.integers(0, 2**32 - 1))
def test_adding_a_plane_adds_it_to_the_vertices(seed):
    shape = (9, 14)
    heights = terrains.noise(shape, seed)
    marked = np.random.default_rng(seed).random(shape) < 0.7
    plain, tilted = (
        rtin.coarsen(rtin.Grid(heights + more), removable=marked, heights="fitted")
        for more in (0.0, terrains.tilted(shape))
    )
    rows, cols = -tilted.vertices[:, 1], tilted.vertices[:, 0]
    plane = 0.75 * rows - 1.25 * cols + 100.0
    np.testing.assert_allclose(z_of(tilted), z_of(plain) + plane, atol=1e-8)


def test_planes_are_found_again():
    grid = rtin.Grid(terrains.tilted((17, 30)))
    mesh = rtin.coarsen(grid, removable=np.zeros(grid.shape, bool))
    bent = with_heights(mesh, z_of(mesh) + np.sin(np.arange(mesh.n_vertices)))
    np.testing.assert_allclose(z_of(rtin.fit_heights(bent, grid)), z_of(mesh), atol=1e-9)


def test_what_fits_exactly_is_left_alone():
    grid = rtin.Grid(terrains.noise((9, 12)))
    lossless = rtin.coarsen(grid, max_error=0.0)
    for max_error in (None, 0.0, 3.0):
        fitted = rtin.fit_heights(lossless, grid, max_error=max_error)
        assert fitted.vertices.tobytes() == lossless.vertices.tobytes()


def test_only_heights_change():
    grid = rtin.Grid(terrains.waves((17, 17)), crs="EPSG:25828")
    mesh = rtin.coarsen(grid, max_error=5.0)
    tagged = TriangleMesh(mesh.vertices, mesh.triangles, mesh.crs, np.arange(mesh.n_triangles))
    fitted = rtin.fit_heights(tagged, grid, max_error=5.0)
    assert z_of(fitted).tobytes() != z_of(mesh).tobytes()
    assert fitted.vertices[:, :2].tobytes() == mesh.vertices[:, :2].tobytes()
    assert fitted.triangles.tobytes() == mesh.triangles.tobytes()
    assert fitted.tags.tobytes() == tagged.tags.tobytes()
    assert fitted.crs == grid.crs
    by_coarsen = rtin.coarsen(grid, max_error=5.0, heights="fitted")
    assert by_coarsen.vertices.tobytes() == fitted.vertices.tobytes()
    sampled = rtin.coarsen(grid, max_error=5.0, heights="sampled")
    assert sampled.vertices.tobytes() == mesh.vertices.tobytes()


# --- with a promise -----------------------------------------------------------------------------


def loosened(mesh, grid, kind, rng):
    """A tolerance for each sample that the mesh keeps: barely, somewhat, or with exact places."""
    errors = abs(naive.surface_minus_samples(mesh, grid))
    errors[np.isnan(errors)] = 0.0
    errors[errors < 1e-9] = 0.0
    slack = np.nextafter(errors, np.inf) * (errors > 0.0)
    if kind == "somewhat":
        return slack + rng.random(grid.shape)
    if kind == "some not at all":
        return slack + (rng.random(grid.shape) < 0.5)
    return slack


kinds = st.sampled_from(["barely", "somewhat", "some not at all"])


@given(terrains.rasters(), terrains.tolerances, kinds, st.integers(0, 2**32 - 1))
def test_the_tolerance_of_every_sample_is_kept(heights, threshold, kind, seed):
    grid = rtin.Grid(heights)
    mesh = rtin.coarsen(grid, threshold=threshold)
    allowed = loosened(mesh, grid, kind, np.random.default_rng(seed))
    fitted = rtin.fit_heights(mesh, grid, max_error=allowed)
    field = rtin.vertical_error(fitted, grid).field
    assert (abs(field) <= allowed)[~np.isnan(field)].all()
    excess = abs(naive.surface_minus_samples(fitted, grid)) - allowed
    assert np.nanmax(excess) < 1e-9
    assert sum_of_squares(fitted, grid) <= sum_of_squares(mesh, grid) * (1 + 1e-12)


@given(terrains.rasters(), st.sampled_from([0.5, 2.0, 10.0]), st.integers(0, 2**32 - 1))
def test_is_nearly_the_least_squares_solution_within_the_tolerance(heights, max_error, seed):
    grid = rtin.Grid(heights)
    mesh = rtin.coarsen(grid, max_error=max_error)
    allowed = loosened(mesh, grid, "somewhat", np.random.default_rng(seed))
    sampled = sum_of_squares(mesh, grid)
    best = with_heights(mesh, naive.least_squares_within(mesh, grid, allowed))
    assert np.nanmax(abs(naive.surface_minus_samples(best, grid)) - allowed) < 1e-6
    least = sum_of_squares(best, grid)
    fitted = sum_of_squares(rtin.fit_heights(mesh, grid, max_error=allowed), grid)
    assert fitted - least <= 0.01 * (sampled - least) + 1e-9


def test_a_fit_that_is_worse_once_it_is_within_the_tolerance_is_dropped():
    grid = rtin.Grid([[1.0, 7.0, 8.0], [1.0, 0.0, 4.0], [4.0, 7.0, 8.0]])
    mesh = rtin.coarsen(grid, removable=np.ones((3, 3), bool))
    slack = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]])
    allowed = abs(rtin.vertical_error(mesh, grid).field) + slack
    fitted = rtin.fit_heights(mesh, grid, max_error=allowed)
    assert fitted.vertices.tobytes() == mesh.vertices.tobytes()


def exact_errors(mesh, grid):
    """Surface - sample in fractions, of a mesh on its grid's lattice."""
    places = grid.places(mesh.vertices[:, :2]).astype(int).tolist()
    z = [Fraction(height) for height in z_of(mesh).tolist()]
    for a, b, c in mesh.triangles.tolist():
        (a_row, a_col), (b_row, b_col), (c_row, c_col) = places[a], places[b], places[c]
        area = (a_row - c_row) * (b_col - c_col) - (b_row - c_row) * (a_col - c_col)
        corners = (places[a], places[b], places[c])
        for row in range(min(r for r, _ in corners), max(r for r, _ in corners) + 1):
            for col in range(min(k for _, k in corners), max(k for _, k in corners) + 1):
                of_a = (row - c_row) * (b_col - c_col) - (b_row - c_row) * (col - c_col)
                of_b = (a_row - c_row) * (col - c_col) - (row - c_row) * (a_col - c_col)
                weights = Fraction(of_a, area), Fraction(of_b, area)
                weights = (*weights, 1 - sum(weights))
                if min(weights) >= 0:
                    surface = sum(w * z[v] for w, v in zip(weights, (a, b, c), strict=True))
                    yield surface - Fraction(float(grid.heights[row, col]))


@pytest.mark.parametrize("name", ["waves", "noise", "staircase", "plateaus"])
@pytest.mark.parametrize("offset", [0.0, 1e8 + 0.1])
def test_the_promise_holds_in_exact_arithmetic(name, offset):
    grid = rtin.Grid(0.9 * terrains.GALLERY[name]((17, 20)) + offset)
    fitted = rtin.coarsen(grid, max_error=7.0, heights="fitted")
    assert fitted.vertices.tobytes() != rtin.coarsen(grid, max_error=7.0).vertices.tobytes()
    rounding = 4 * np.spacing(np.abs(grid.heights).max().astype(float))
    assert max(map(abs, exact_errors(fitted, grid))) <= Fraction(7.0) + Fraction(rounding)
    assert rtin.vertical_error(fitted, grid).max <= 7.0


def test_places_without_a_tolerance_stay_and_others_move():
    heights = np.maximum(terrains.waves((65, 65)), 40.0)
    grid, allowed = rtin.Grid(heights), np.where(heights == 40.0, 0.0, 5.0)
    mesh = rtin.coarsen(grid, max_error=allowed)
    fitted = rtin.coarsen(grid, max_error=allowed, heights="fitted")
    before, after = rtin.vertical_error(mesh, grid), rtin.vertical_error(fitted, grid)
    assert (abs(after.field) <= allowed).all()
    # Where only their vertices held triangles back as a whole, it would be 0.71.
    assert after.rms < 0.69 * before.rms


def test_real_terrain_is_a_seventh_closer_within_the_same_tolerance():
    grid = rtin.samples.jacksboro_fault()
    sampled, fitted = (
        rtin.vertical_error(rtin.coarsen(grid, max_error=25.0, heights=heights), grid)
        for heights in ("sampled", "fitted")
    )
    assert fitted.max <= 25.0
    assert fitted.rms < 0.85 * sampled.rms


def test_a_budget_promises_no_largest_error():
    grid = rtin.samples.topobathy()
    sampled = rtin.coarsen(grid, max_triangles=3000)
    fitted = rtin.coarsen(grid, max_triangles=3000, heights="fitted")
    assert fitted.triangles.tobytes() == sampled.triangles.tobytes()
    before, after = rtin.vertical_error(sampled, grid), rtin.vertical_error(fitted, grid)
    assert after.rms < 0.9 * before.rms
    assert after.max > before.max


@pytest.mark.parametrize("max_error", [None, 25.0])
def test_number_of_threads_changes_no_byte(max_error, monkeypatch):
    grid = rtin.samples.jacksboro_fault()
    mesh = rtin.coarsen(grid, max_error=25.0)
    results = []
    for n_threads in ("1", "2", "3"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        fitted = rtin.fit_heights(mesh, grid, max_error=max_error)
        results.append(fitted.vertices.tobytes())
    assert results[0] == results[1] == results[2] != mesh.vertices.tobytes()


# --- meshes from elsewhere ----------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.sampled_from([5, 12, 40]), st.booleans())
def test_fits_meshes_whose_vertices_lie_anywhere(seed, n_points, beyond):
    rng = np.random.default_rng(seed)
    grid = rtin.Grid(terrains.pierced(terrains.waves((14, 17)), rng.random((14, 17)) < 0.1))
    points = rng.random((n_points, 2)) * (16.0, -13.0) * (1.4 if beyond else 1.0)
    mesh = meshes.delaunay(points, rng)
    fitted = rtin.fit_heights(mesh, grid)
    _, weights = naive.weights_at_samples(mesh, grid)
    expected = naive.least_squares_heights(mesh, grid)
    np.testing.assert_allclose(weights @ z_of(fitted), weights @ expected, atol=1e-5)
    unseen = (weights**2).sum(axis=0) < 0.25
    assert (z_of(fitted)[unseen] == z_of(mesh)[unseen]).all()
    max_error = rtin.vertical_error(mesh, grid).max
    within = rtin.fit_heights(mesh, grid, max_error=max_error)
    assert rtin.vertical_error(within, grid).max <= max_error
    assert sum_of_squares(within, grid) <= sum_of_squares(mesh, grid)


def test_a_sample_on_an_edge_counts_once():
    grid = rtin.Grid([[0.0, 0.0, 6.0, 0.0, 0.0]] * 2)
    mesh = TriangleMesh([[0, 0, 0], [4, 0, 0], [0, -1, 0], [4, -1, 0]], [[0, 2, 1], [2, 3, 1]])
    expected = naive.least_squares_heights(mesh, grid)
    np.testing.assert_allclose(z_of(rtin.fit_heights(mesh, grid)), expected, atol=1e-9)


def test_vertices_that_no_sample_sees_stay():
    grid = rtin.Grid(terrains.noise((5, 5)))
    seen = [[0, 0, 0], [4, 0, 0], [0, -4, 0]]
    unseen = [[4, -4, 7], [8.0, 4.0, 3], [1.3, -1.2, 9], [1.6, -1.4, 9], [1.4, -1.7, 9]]
    triangles = [[0, 2, 1], [3, 4, 4], [5, 7, 6]]  # none at 3, flat, and between samples
    fitted = rtin.fit_heights(TriangleMesh(seen + unseen, triangles), grid)
    assert (z_of(fitted)[3:] == [7, 3, 9, 9, 9]).all()
    assert (z_of(fitted)[:3] != 0).all()


# --- the door -----------------------------------------------------------------------------------


def test_refuses_a_tolerance_that_the_mesh_does_not_keep():
    grid = rtin.Grid(terrains.spike((9, 9)))
    mesh = rtin.coarsen(grid, max_error=60.0)
    message = "max_error must be what the mesh keeps already, got 5 at row 6, column 3, .* 50 off"
    with pytest.raises(ValueError, match=message):
        rtin.fit_heights(mesh, grid, max_error=5.0)
    allowed = np.full(grid.shape, 60.0)
    rtin.fit_heights(mesh, grid, max_error=allowed)
    allowed[6, 3] = 5.0
    with pytest.raises(ValueError, match=message):
        rtin.fit_heights(mesh, grid, max_error=allowed)


@pytest.mark.parametrize(
    ("wrong", "kind", "message"),
    [
        (-1.0, ValueError, "max_error must be zero or more"),
        (np.nan, ValueError, "max_error must be zero or more"),
        ("5", TypeError, "max_error must be"),
        (np.ones((3, 3)), ValueError, "have the grid's shape"),
        (np.full((9, 9), -1.0), ValueError, "got -1.0 at row 0, column 0"),
    ],
)
def test_wants_a_tolerance_that_makes_sense(wrong, kind, message):
    grid = rtin.Grid(terrains.waves((9, 9)))
    with pytest.raises(kind, match=message):
        rtin.fit_heights(rtin.coarsen(grid, max_error=1.0), grid, max_error=wrong)


def test_wants_a_mesh_over_the_grid():
    grid = rtin.Grid(terrains.waves((9, 9)))
    mesh = rtin.coarsen(grid, max_error=1.0)
    with pytest.raises(TypeError, match="a TriangleMesh is wanted"):
        rtin.fit_heights(grid, mesh)
    with pytest.raises(TypeError, match="a Grid is wanted"):
        rtin.fit_heights(mesh, grid.heights)
    with pytest.raises(ValueError, match="finite vertices is wanted"):
        rtin.fit_heights(with_heights(mesh, np.full(mesh.n_vertices, np.nan)), grid)
    with pytest.raises(ValueError, match="the mesh covers no sample"):
        rtin.fit_heights(mesh, rtin.Grid(grid.heights, Affine.translation(1e6, 0.0)))


def test_wants_one_of_two_words():
    with pytest.raises(ValueError, match="heights must be 'sampled' or 'fitted', got 'best'"):
        rtin.coarsen(rtin.Grid(np.zeros((3, 3))), max_error=1.0, heights="best")


def test_the_command_line_fits_heights(tmp_path):
    dem, out = tmp_path / "dem.npy", tmp_path / "out.ply"
    np.save(dem, terrains.waves((33, 33)))
    rms = {}
    for heights in ("sampled", "fitted"):
        arguments = ["coarsen", dem, out, "--max-error", "4", "--heights", heights, "--json"]
        result = CliRunner().invoke(app, list(map(str, arguments)))
        assert result.exit_code == 0, result.output
        achieved = json.loads(result.stdout)["achieved"]
        assert achieved["max_error"] <= 4.0
        rms[heights] = achieved["rms"]
    assert rms["fitted"] < 0.95 * rms["sampled"]
