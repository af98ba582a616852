"""`vertex_errors` and `vertical_error` against their naive twins, and on meshes of others."""

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import naive
import rtin
import terrains
from rtin.mesh import TriangleMesh


def grid_of(heights, **options):
    return rtin.Grid(np.asarray(heights, dtype=np.float32), **options)


# --- Eq. (1) ------------------------------------------------------------------------------------


@given(terrains.rasters(largest=24))
def test_eq_1_at_every_vertex(heights):
    grid = grid_of(heights)
    errors = rtin.vertex_errors(grid)
    assert errors.dtype == np.float32
    np.testing.assert_array_equal(errors, naive.vertex_errors(grid.heights).astype(np.float32))


@pytest.mark.parametrize("shape", terrains.SHAPES, ids=str)
@pytest.mark.parametrize("holes", ["none", "scattered"])
def test_eq_1_on_every_shape(shape, holes):
    heights = terrains.pierced(terrains.noise(shape), terrains.HOLES[holes](shape))
    np.testing.assert_array_equal(rtin.vertex_errors(heights), naive.vertex_errors(heights))


def test_the_corners_of_the_lattice_cannot_be_removed():
    errors = rtin.vertex_errors(np.zeros((9, 9)))
    infinite = np.argwhere(np.isinf(errors))
    assert infinite.tolist() == [[0, 0], [0, 8], [8, 0], [8, 8]]


def test_eq_1_is_computed_in_float64_and_rounded_once():
    heights = np.array([[1e8, 1e8 + 0.3, 1e8 + 0.1]] * 3)
    expected = abs((heights[0, 0] + heights[0, 2]) / 2 - heights[0, 1])
    assert rtin.vertex_errors(heights)[0, 1] == np.float32(expected)


def test_eq_1_of_large_rasters_does_not_depend_on_threads(monkeypatch):
    heights = rtin.samples.jacksboro_fault().heights
    results = []
    for n_threads in ("1", "3"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        results.append(rtin.vertex_errors(heights).tobytes())
    assert results[0] == results[1]


# --- the vertical error -------------------------------------------------------------------------


def assert_measures(mesh, grid, atol=1e-9):
    """Compare everything that is measured with the barycentric field; return that."""
    field = naive.surface_minus_samples(mesh, grid)
    error = rtin.vertical_error(mesh, grid)
    np.testing.assert_allclose(error.field, field, atol=atol, rtol=0)
    sizes = abs(field[~np.isnan(field)])
    assert error.n_samples == len(sizes)
    assert error.n_uncovered == grid.n_samples - len(sizes)
    assert error.max == pytest.approx(sizes.max(), abs=atol)
    assert error.mean == pytest.approx(sizes.mean(), abs=atol)
    assert error.rms == pytest.approx(np.sqrt((sizes**2).mean()), abs=atol)
    assert abs(error.field[error.sample]) == error.max
    return field


@given(terrains.rasters(), terrains.tolerances)
def test_measures_a_coarsened_mesh(heights, tolerance):
    grid = grid_of(heights)
    field = assert_measures(rtin.coarsen(grid, threshold=tolerance), grid, atol=1e-10)
    uncovered = ~np.isnan(grid.heights) & np.isnan(field)
    covered = naive.corners_of(naive.finest(grid.heights))
    assert {tuple(place) for place in np.argwhere(uncovered)} == {
        tuple(place) for place in np.argwhere(~np.isnan(grid.heights))
    } - covered


@pytest.mark.parametrize("transform", terrains.TRANSFORMS)
@pytest.mark.parametrize("holes", ["none", "pond"])
def test_measures_under_every_transform(transform, holes):
    shape = (17, 23)
    heights = terrains.pierced(terrains.waves(shape), terrains.HOLES[holes](shape))
    grid = grid_of(heights, transform=terrains.TRANSFORMS[transform])
    plain = grid_of(heights)
    mesh = rtin.coarsen(grid, max_error=6.0)
    assert_measures(mesh, grid, atol=1e-6)
    error = rtin.vertical_error(mesh, grid)
    assert error.max == rtin.vertical_error(rtin.coarsen(plain, max_error=6.0), plain).max
    assert error.max <= 6.0


@pytest.mark.parametrize("transform", ["north up", "rotated", "oblong cells"])
def test_measures_a_foreign_triangulation(transform):
    spatial = pytest.importorskip("scipy.spatial")
    shape = (30, 40)
    grid = grid_of(terrains.waves(shape), transform=terrains.TRANSFORMS[transform])
    rng = np.random.default_rng(3)
    col, row = rng.random((2, 60)) * np.array([[43.0], [33.0]]) - 2.0
    x, y = grid.transform @ (col, row)
    triangles = spatial.Delaunay(np.column_stack([col, row])).simplices
    mesh = TriangleMesh.from_triangles(np.column_stack([x, y, 30 * rng.random(60)]), triangles)
    field = assert_measures(mesh, grid, atol=1e-5)
    assert np.isnan(field).any()
    assert not np.isnan(field).all()


def test_takes_the_first_of_equally_bad_samples():
    heights = np.zeros((5, 5))
    heights[3, 1] = heights[1, 3] = 2.0
    grid = grid_of(heights)
    error = rtin.vertical_error(rtin.coarsen(grid, max_error=2.0), grid)
    assert (error.max, error.sample) == (2.0, (1, 3))


def test_takes_the_first_of_equally_bad_samples_in_any_band():
    heights = np.zeros((257, 257))
    heights[[20, 90, 200], [40, 40, 40]] = 5.0
    error = rtin.vertical_error(rtin.coarsen(grid_of(heights), max_error=9.0), grid_of(heights))
    assert (error.max, error.sample) == (5.0, (20, 40))


def test_vertices_a_hair_beside_their_samples_are_at_them():
    grid = grid_of(terrains.waves((9, 9)))
    mesh = rtin.coarsen(grid, max_error=3.0)
    moved = mesh.vertices + np.array([1e-8, -1e-8, 0.0])
    error = rtin.vertical_error(TriangleMesh(moved, mesh.triangles), grid)
    assert (error.max, error.n_uncovered) == (rtin.vertical_error(mesh, grid).max, 0)


def test_an_exact_mesh_has_no_error_at_utm_coordinates():
    transform = Affine(30.0, 0.0, 399_960.0, 0.0, -30.0, 8_000_010.0)
    grid = grid_of(terrains.noise((33, 33)), transform=transform)
    error = rtin.vertical_error(rtin.coarsen(grid, max_error=0), grid)
    assert (error.max, error.rms, error.mean) == (0.0, 0.0, 0.0)


def test_a_mesh_beside_the_raster_is_refused():
    grid = grid_of(np.ones((4, 4)))
    mesh = TriangleMesh([[50, 50, 0], [60, 50, 0], [50, 60, 0]], [[1, 2, 0]])
    with pytest.raises(ValueError, match="covers no sample of the grid"):
        rtin.vertical_error(mesh, grid)


def test_triangles_without_area_are_passed_over():
    grid = grid_of(np.ones((3, 3)))
    corners = [[0, 0, 9], [1, 0, 9], [2, 0, 9], [0, -1, 1], [1, -1, 1]]
    mesh = TriangleMesh(corners, [[0, 1, 2], [3, 4, 0], [0, 1, 2]])
    error = rtin.vertical_error(mesh, grid)
    assert (error.n_samples, error.n_uncovered) == (3, 6)


@given(st.sampled_from([0.0, 5.0, 40.0]))
def test_number_of_threads_changes_no_figure(tolerance):
    grid = rtin.samples.topobathy()
    mesh = rtin.coarsen(grid, threshold=tolerance)
    results = []
    for n_threads in ("1", "3"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("RTIN_NUM_THREADS", n_threads)
            error = rtin.vertical_error(mesh, grid)
            results.append((error.max, error.rms, error.mean, error.field.tobytes()))
    assert results[0] == results[1]


def test_shows_what_matters():
    grid = grid_of([[0, 0, 0], [0, 4, 0], [0, 0, 0]])
    error = rtin.vertical_error(rtin.coarsen(grid, max_error=5), grid)
    assert repr(error).startswith("<VerticalError max 4 at row 1, column 1; rms 1.33333, mean 0.4")


@pytest.mark.parametrize("wrong", [np.zeros((3, 3)), None])
def test_wants_a_mesh_and_a_grid(wrong):
    grid = grid_of(np.zeros((3, 3)))
    mesh = rtin.coarsen(grid, max_error=1)
    with pytest.raises(TypeError, match="a Grid is wanted, got"):
        rtin.vertical_error(mesh, wrong)
    with pytest.raises(TypeError, match="a TriangleMesh is wanted, got"):
        rtin.vertical_error(wrong, grid)
