"""Metro's samples: how many, where, and what they stand for."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import naive
import rtin
import surfaces
from rtin.mesh import TriangleMesh
from surfaces import cloud, full

INSIDE = ["subdivision", "montecarlo", "similar"]
FAR = cloud(np.array([[0.0, 0.0, 1e3]]))


def samples_of(surface, sampling="subdivision", n_samples=None, seed=0):
    return rtin.compare(surface, FAR, sampling, samples=n_samples, seed=seed).forward.field


def area_of(surface):
    mesh = full(surface) if isinstance(surface, rtin.Grid) else surface
    return sum(naive.area_of(*mesh.vertices[triangle]) for triangle in mesh.triangles)


def in_any_order(points):
    return points[np.lexsort(np.round(points, 7).T)]


@given(st.sampled_from(INSIDE), st.integers(1, 900), st.integers(0, 2**32 - 1))
def test_takes_what_metro_takes(sampling, n_samples, seed):
    rng = np.random.default_rng(seed)
    triangles = np.array([rng.permutation(9)[:3] for _ in range(rng.integers(1, 13))])
    mesh = TriangleMesh(rng.random((9, 3)) * 5.0, triangles)
    corners, on_edges, counts, areas = naive.metro(mesh, n_samples, sampling)
    points, _, stands_for = samples_of(mesh, sampling, n_samples)
    n_outside = len(corners) + len(on_edges)
    assert len(points) == n_outside + sum(counts)
    np.testing.assert_array_equal(stands_for[:n_outside], 0.0)
    np.testing.assert_allclose(points[: len(corners)], corners, atol=1e-13)
    np.testing.assert_allclose(
        points[len(corners) : n_outside], on_edges.reshape(-1, 3), atol=1e-13
    )
    if sum(counts):
        assert stands_for.sum() == pytest.approx(sum(areas), rel=1e-12)
    first = n_outside
    for triangle, count in zip(triangles, counts, strict=True):
        own = points[first : first + count]
        first += count
        if sampling == "montecarlo":
            assert_inside(own, mesh.vertices[triangle])
        elif count:
            expected = np.array(naive.PLACED[sampling](mesh.vertices[triangle], count))
            np.testing.assert_allclose(in_any_order(own), in_any_order(expected), atol=1e-12)


def assert_inside(points, corners):
    shares = np.linalg.lstsq(
        np.vstack([corners.T, np.ones(3)]), np.vstack([points.T, np.ones(len(points))]), rcond=None
    )[0]
    assert (shares > -1e-9).all()
    np.testing.assert_allclose(shares.T @ corners, points, atol=1e-9)


@pytest.mark.parametrize("name", [*surfaces.GRIDS, "coarsened", "soup", "tiny beside huge"])
@pytest.mark.parametrize("sampling", INSIDE)
def test_takes_about_as_many_as_wanted_and_they_stand_for_the_whole(name, sampling):
    surface = (surfaces.MESHES | surfaces.GRIDS)[name]()
    points, _, areas = samples_of(surface, sampling, 30_000)
    assert 25_500 < len(points) <= 30_000
    # A piece of tiny triangles alone may get no sample.
    assert areas.sum() == pytest.approx(area_of(surface), rel=1e-5)
    assert (areas >= 0.0).all()


@pytest.mark.parametrize("sampling", INSIDE)
def test_triangles_without_a_sample_are_counted_to_others(sampling):
    mesh = surfaces.soup(400)  # pieces of 16 triangles
    areas = samples_of(mesh, sampling, 4000)[2]
    assert 100 < (areas > 0.0).sum() < 350
    assert areas.sum() == pytest.approx(area_of(mesh), rel=1e-12)


def many_pieces():
    """A grid of several pieces, and the mesh of its triangles, which has others."""
    heights = np.random.default_rng(1).random((150, 260))
    heights[40:90, 100:130] = np.nan
    return rtin.Grid(heights)


def test_corners_and_edges_of_a_grid_are_taken_once():
    grid = many_pieces()
    mesh = full(grid)
    side, other = (rtin.compare(s, FAR, samples=500_000).forward.field for s in (grid, mesh))
    used = mesh.vertices[np.unique(mesh.triangles)]
    at_samples = {tuple(point) for point in side.points[side.areas == 0.0]}
    assert {tuple(point) for point in used} <= at_samples
    n_flat = [(field.areas == 0.0).sum() for field in (side, other)]
    assert abs(n_flat[0] - n_flat[1]) <= 10  # one for each piece's rounding
    assert len(side.points) == pytest.approx(len(other.points), rel=1e-3)
    assert side.areas.sum() == pytest.approx(other.areas.sum(), rel=1e-9)
    assert rtin.compare(grid, FAR, "vertices").forward.n_samples == len(used)


def test_all_edges_get_points():
    grid = rtin.Grid(np.where(np.indices((9, 12))[1] == 6, np.nan, np.indices((9, 12))[0] * 1.0))
    mesh = full(grid)
    for surface in (grid, mesh):
        points, _, areas = samples_of(surface, "subdivision", 60_000)
        flat = {tuple(point) for point in np.round(points[areas == 0.0], 6)}
        assert len(flat) == (areas == 0.0).sum()  # none twice
        for a, b in mesh.edges():
            side = mesh.vertices[b] - mesh.vertices[a]
            off = points[areas == 0.0] - mesh.vertices[a]
            share = off @ side / (side @ side)
            is_on = np.linalg.norm(off - share[:, None] * side, axis=1) < 1e-9
            assert (is_on & (share > 0.01) & (share < 0.99)).sum() >= 10


@pytest.mark.parametrize("sampling", ["subdivision", "similar"])
def test_a_triangle_takes_points_evenly(sampling):
    """Their mean is its centre, where the mean of every linear function is."""
    corners = np.random.default_rng(2).random((3, 3))
    points, _, areas = samples_of(TriangleMesh(corners, [[0, 1, 2]]), sampling, 20_000)
    mean = np.average(points, axis=0, weights=areas)
    np.testing.assert_allclose(mean, corners.mean(axis=0), rtol=1e-9)


def test_parts_of_huge_triangles_share_a_linear_functions_mean():
    rng = np.random.default_rng(5)
    mesh = TriangleMesh(rng.random((5, 3)), [[0, 1, 2], [1, 2, 3], [2, 3, 4]])
    points, _, areas = samples_of(mesh, "subdivision", 100_000)
    centres = mesh.vertices[mesh.triangles].mean(axis=1)
    own = [naive.area_of(*mesh.vertices[t]) for t in mesh.triangles]
    expected = np.average(centres, axis=0, weights=own)
    np.testing.assert_allclose(np.average(points, axis=0, weights=areas), expected, rtol=1e-9)


def test_random_points_are_spread_evenly():
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 1, 0]], [[0, 1, 2], [1, 3, 2]])
    points, _, areas = samples_of(mesh, "montecarlo", 100_000, seed=4)
    x, y = points[areas > 0.0, :2].T
    inside = x + y < 1.0
    n_cells = 8
    row, col = np.int64(y[inside] * n_cells), np.int64(x[inside] * n_cells)
    is_upper = (x[inside] * n_cells) % 1 + (y[inside] * n_cells) % 1 > 1.0
    counts = np.bincount(2 * (row * n_cells + col) + is_upper, minlength=2 * n_cells**2)
    cells = [2 * (r * n_cells + c) + h for r in range(8) for c in range(8 - r) for h in (0, 1)]
    cells = [cell for cell in cells if cell % 2 == 0 or sum(divmod(cell // 2, 8)) < 7]
    assert counts.sum() == counts[cells].sum()
    assert stats.chisquare(counts[cells]).pvalue > 0.01
    assert inside.mean() == pytest.approx(0.5 / (0.5 + 1.5), abs=1e-3)


def test_seeds_change_random_points_only():
    mesh = surfaces.soup(20)
    for sampling in INSIDE:
        one, same, other = (samples_of(mesh, sampling, 2000, seed)[0] for seed in (7, 7, 2**70))
        np.testing.assert_array_equal(one, same)
        assert (one.tobytes() == other.tobytes()) == (sampling != "montecarlo")


def test_corners_are_samples_whatever_the_number():
    mesh = surfaces.soup(20)
    for n_samples in (1, 59, 60):
        points, _, areas = samples_of(mesh, "subdivision", n_samples)
        np.testing.assert_allclose(points, mesh.vertices, atol=1e-13)
        assert not areas.any()


def test_ten_samples_a_triangle_by_default():
    grid = many_pieces()
    mesh = rtin.coarsen(grid, max_error=0.3)
    result = rtin.compare(mesh, grid, "montecarlo")
    wanted = 10 * full(grid).n_triangles
    assert result.backward.n_samples == pytest.approx(wanted, abs=10)
    assert result.forward.n_samples == pytest.approx(wanted, abs=10)


@pytest.mark.parametrize("width", [0.0, 1e-150, 1e-12, 1e-3])
def test_edges_of_slivers_get_no_more_than_wanted(width):
    mesh = TriangleMesh([[0, 0, 0], [9, 1, 3], [18, 2 + width, 6]], [[0, 1, 2]])
    side = rtin.compare(mesh, FAR, samples=1000).forward
    assert 900 <= side.n_samples <= 1000


def test_points_without_a_size_are_one_sample_each():
    assert rtin.compare(FAR, FAR, samples=1000).forward.n_samples == 1


def test_huge_numbers_of_samples_are_never_there_at_once():
    two = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], [[0, 1, 2], [1, 3, 2]])
    for sampling in INSIDE:
        rtin.compare(two, two, sampling, samples=100)  # compiles
        tracemalloc.start()
        result = rtin.compare(two, FAR, sampling, samples=1_000_000)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert result.forward.n_samples > 900_000
        assert most < 20e6  # bytes: less than the points alone
