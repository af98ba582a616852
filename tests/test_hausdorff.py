"""Bounds of the Hausdorff distance: that they hold, that they meet, and that it takes few parts."""

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

import naive
import rtin
import terrains
from meshes import seeds
from rtin.mesh import TriangleMesh

LARGE = 257  # an edge of so many triangles that bisecting at each of them would not end


def lattice(heights, slant=0, place=(0.0, 0.0), step=1.0):
    """Two triangles in each cell, all cut along the same diagonal."""
    n_rows, n_cols = heights.shape
    row, col = np.indices(heights.shape)
    vertices = np.stack([place[0] + step * col, place[1] + step * row, heights], axis=2)
    first = (np.arange(n_rows - 1)[:, None] * n_cols + np.arange(n_cols - 1)).ravel()
    a, b, c, d = first, first + 1, first + n_cols, first + n_cols + 1
    halves = [(a, b, c), (b, d, c)] if slant else [(a, b, d), (a, d, c)]
    triangles = np.concatenate([np.column_stack(half) for half in halves])
    return TriangleMesh.from_triangles(vertices.reshape(-1, 3), triangles)


def shifted(mesh, x, y, z):
    return TriangleMesh(mesh.vertices + np.array([x, y, z]), mesh.triangles)


def lifted(mesh, up):
    return shifted(mesh, 0.0, 0.0, up)


def square(height=0.0, side=8.0):
    return lattice(np.full((2, 2), height), step=side)


def pyramid(height, side=8.0):
    base = np.array([[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0]])
    apex = [[side / 2, side / 2, height]]
    return TriangleMesh(np.r_[base, apex], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def soup(rng, kind, size=6.0):
    """A small surface of one kind: some of these no terrain would ever be."""
    if kind == "grid":
        heights = rng.integers(-8, 8, (4, 5)) / 4.0
        heights[rng.random((4, 5)) < 0.15] = np.nan
        heights[:2, :2] = 1.0
        turn = Affine.rotation(rng.uniform(0, 90))
        return rtin.Grid(heights, turn @ Affine.scale(size / 4, -size / 4))
    if kind == "triangles":  # that pierce and overlap each other
        corners = rng.uniform(0, size, (5, 3, 3)) * [1, 1, 0.4]
        return TriangleMesh(corners.reshape(-1, 3), np.arange(15).reshape(5, 3))
    points = np.column_stack([rng.uniform(0, size, (9, 2)), rng.uniform(-2, 2, 9)])
    triangles = Delaunay(points[:, :2]).simplices
    if kind == "overlapping":
        other = points + rng.normal(0, 0.3, 3)
        points, triangles = np.r_[points, other], np.r_[triangles, triangles[::2, ::-1] + 9]
    if kind == "degenerate":  # points, lines and walls among the triangles
        top = points[:3] + np.array([0.0, 0.0, 1.5])
        points = np.r_[points, top]
        triangles = np.r_[triangles[1:], [[0, 0, 0], [1, 2, 1], [0, 1, 9], [1, 10, 9], [2, 1, 10]]]
    if kind == "holes":
        triangles = triangles[rng.random(len(triangles)) < 0.6]
        triangles = triangles if len(triangles) else np.array([[0, 1, 2]])
    return TriangleMesh(points, triangles)


KINDS = ["grid", "delaunay", "overlapping", "degenerate", "holes", "triangles"]


def points_on(surface, n):
    """A lattice of points in each triangle."""
    shares = [(i / n, j / n) for i in range(n + 1) for j in range(n + 1 - i)]
    triangles = np.array(naive.triangles_in_space(surface), float)
    return np.array([a + u * (b - a) + v * (c - a) for a, b, c in triangles for u, v in shares])


def assert_bounds(found, exact, tolerance, rounding=1e-9):
    assert found.lower - rounding <= exact <= found.upper + rounding
    assert found.upper <= found.lower + tolerance + rounding


# --- cases with an exact answer -----------------------------------------------------------------


def test_of_parallel_planes_is_their_distance():
    found = rtin.hausdorff(square(), square(3.0), tolerance=1e-6)
    assert_bounds(found, 3.0, 1e-6)


def test_of_a_pyramid_and_its_base_is_its_height():
    """To the base from the apex; from the base's centre the slopes are nearer."""
    found = rtin.hausdorff(pyramid(3.0), square(), tolerance=1e-7)
    assert_bounds(found, 3.0, 1e-7)
    assert found.place == (4.0, 4.0, 3.0)
    slope = 3.0 / np.hypot(3.0, 4.0) * 4.0  # equally far from all four sides, at the centre
    assert found.backward.lower - 1e-9 <= slope <= found.backward.upper + 1e-9
    assert found.backward.place == pytest.approx((4.0, 4.0, 0.0), abs=1e-3)


def test_of_a_spike_is_its_height():
    heights = np.zeros((9, 9))
    heights[4, 4] = 50.0
    assert_bounds(
        rtin.hausdorff(lattice(heights), rtin.Grid(np.zeros((9, 9)), Affine.scale(1.0))), 50.0, 0.05
    )


@pytest.mark.parametrize("slope", [0.0, 0.5, 3.0])
def test_of_a_plane_shifted_along_its_normal(slope):
    """Across the edges of either the other's triangles lie elsewhere."""
    col = np.indices((17, 17))[1]
    plane = lattice(slope * col.astype(float))
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    other = lattice(slope * col.astype(float), slant=1)
    other = shifted(other, *(2.0 * normal))
    assert_bounds(rtin.hausdorff(plane, other, tolerance=1e-6), 2.0, 1e-6)


def test_of_a_lid_over_a_valley_is_where_both_sides_are_equally_far():
    """A whole line of the lid is; under it no triangle has an edge."""
    left, right = np.array([-4.0, 4.0]), np.array([12.0, 3.0])  # x and z of both rims
    valley = TriangleMesh(
        [(x, y, z) for y in (0, 30) for x, z in (left, (0, 0), right)],
        [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]],
    )
    lid = TriangleMesh([[-1, 5, 2], [4, 5, 2], [4, 25, 2], [-1, 25, 2]], [[0, 1, 2], [0, 2, 3]])
    steep, gentle = np.hypot(*left), np.hypot(*right)
    # (2 + x) cos of the left slope = (2 − x / 4) cos of the right one, 1 : 4
    to_left, to_right = 4.0 / steep, 12.0 / gentle
    x = 2.0 * (to_right - to_left) / (to_left + to_right / 4.0)
    found = rtin.hausdorff(lid, valley, tolerance=1e-8).forward
    assert_bounds(found, (2.0 + x) * to_left, 1e-8)


def test_between_surfaces_far_apart():
    one, other = square(side=1.0), square(side=1.0)
    other = shifted(other, 1000.0, 0.0, 0.0)
    assert_bounds(rtin.hausdorff(one, other, tolerance=1e-4), 1000.0, 1e-4)


# --- the same surface in other triangles --------------------------------------------------------


@pytest.mark.parametrize("shape", ["flat", "tilted", "island"])
def test_of_a_lossless_mesh_of_a_large_grid_is_nothing(shape):
    row, col = np.indices((LARGE, LARGE))
    heights = {
        "flat": np.zeros((LARGE, LARGE)),
        "tilted": 0.75 * row - 1.25 * col,
        "island": np.maximum(0.0, np.round(40 * np.sin(row / 31) * np.cos(col / 43))),
    }[shape]
    grid = rtin.Grid(heights)
    found = rtin.hausdorff(grid, rtin.coarsen(grid, max_error=0.0))
    assert found.upper <= 1e-9 * LARGE * 2


@pytest.mark.parametrize("up", [0.0, 1.0])
def test_of_a_large_plane_cut_along_either_diagonal(up):
    row, col = np.indices((LARGE, LARGE))
    heights = 0.5 * col + 0.25 * row
    one, other = lattice(heights), lattice(heights, slant=1)
    found = rtin.hausdorff(one, lifted(other, up), tolerance=1e-8)
    assert_bounds(found, up, 1e-8)


def test_inside_a_larger_plane_of_other_triangles():
    """The nearest triangle is not the one below; the way to it is the same everywhere."""
    col = np.indices((101, 101))[1]
    small = lattice(0.5 * col + 3.0)
    col = np.indices((90, 90))[1]
    large = lattice(0.5 * (1.5 * col - 15.0), slant=1, place=(-15.0, -15.0), step=1.5)
    found = rtin.hausdorff(small, large, tolerance=1e-7).forward
    assert_bounds(found, 3.0 / np.hypot(1.0, 0.5), 1e-7)


def test_of_a_wall_cut_along_either_diagonal():
    """Seen from above there is nothing to lay one over the other."""
    walls = [lattice(np.zeros((21, 31)), slant) for slant in (0, 1)]
    one, other = (TriangleMesh(w.vertices[:, [0, 2, 1]], w.triangles) for w in walls)
    assert rtin.hausdorff(one, other, tolerance=1e-9).upper <= 1e-9
    apart = shifted(other, 0.0, 0.5, 0.0)
    assert_bounds(rtin.hausdorff(one, apart, tolerance=1e-7), 0.5, 1e-7)


def test_of_two_sheets_above_each_other():
    """Both overlap themselves: the nearest triangle is in either sheet."""
    sheets = [lattice(np.full((33, 33), z), slant) for slant in (0, 1) for z in (0.0, 7.0)]

    def both(lower, upper):
        vertices = np.r_[lower.vertices, upper.vertices]
        return TriangleMesh(vertices, np.r_[upper.triangles + 33 * 33, lower.triangles])

    found = rtin.hausdorff(both(*sheets[:2]), both(*sheets[2:]), tolerance=1e-8)
    assert found.upper <= 1e-8


# --- any surfaces -------------------------------------------------------------------------------


@settings(max_examples=15)
@given(seeds, st.sampled_from(KINDS), st.sampled_from(KINDS), st.sampled_from([1e-1, 1e-3, 1e-6]))
def test_bounds_hold_and_are_as_near_as_asked_for(seed, kind_a, kind_b, tolerance):
    rng = np.random.default_rng(seed)
    a, b = soup(rng, kind_a), soup(rng, kind_b)
    found = rtin.hausdorff(a, b, tolerance=tolerance)
    for bounds, source, target in ((found.forward, a, b), (found.backward, b, a)):
        assert naive.distances(points_on(source, 2), target).max() <= bounds.upper + 1e-9
        assert bounds.upper <= bounds.lower + tolerance + 1e-9
        place = np.array([bounds.place])
        assert naive.distances(place, target)[0] == pytest.approx(bounds.lower, abs=1e-9)


@given(seeds, st.sampled_from(KINDS), st.sampled_from(KINDS))
def test_closer_bounds_lie_within_wider_ones(seed, kind_a, kind_b):
    rng = np.random.default_rng(seed)
    a, b = soup(rng, kind_a), soup(rng, kind_b)
    wide, close = (rtin.hausdorff(a, b, tolerance=tolerance) for tolerance in (0.3, 1e-7))
    assert close.lower <= wide.upper + 1e-9
    assert wide.lower <= close.upper + 1e-9


@pytest.mark.parametrize("tolerance", [2.0, 0.5, 0.1])
def test_a_wide_bound_holds_where_surfaces_are_laid_over_each_other(tolerance):
    """Bounds from few and large polygons, with the maximum inside them."""
    rng = np.random.default_rng(11)
    for _ in range(20):
        one = lattice(rng.uniform(0, 4, (6, 6)), step=6.0)
        other = lattice(rng.uniform(0, 4, (5, 5)), slant=1, step=7.5)
        close = rtin.hausdorff(one, other, tolerance=1e-7)
        wide = rtin.hausdorff(one, other, tolerance=tolerance)
        for narrow, bounds in ((close.forward, wide.forward), (close.backward, wide.backward)):
            assert bounds.lower - 1e-9 <= narrow.lower <= narrow.upper <= bounds.upper + 2e-7


@given(terrains.rasters(largest=17), terrains.tolerances)
def test_holds_more_than_samples_say_on_terrain(heights, max_error):
    grid = rtin.Grid(heights)
    mesh = rtin.coarsen(grid, max_error=min(max_error, 40.0))
    found, sampled = rtin.hausdorff(grid, mesh), rtin.compare(grid, mesh)
    assert found.upper >= sampled.hausdorff - 1e-9
    assert found.lower <= min(max_error, 40.0) + 1e-9 or np.isnan(heights).any()
    gap = max(1e-3 * found.lower, 1e-9 * max(20.0, np.nanmax(abs(heights))) * 2)
    assert found.upper <= found.lower + gap


@given(seeds, st.sampled_from(KINDS), st.sampled_from(KINDS))
def test_is_the_same_in_both_orders(seed, kind_a, kind_b):
    rng = np.random.default_rng(seed)
    a, b = soup(rng, kind_a), soup(rng, kind_b)
    one, other = rtin.hausdorff(a, b, tolerance=0.01), rtin.hausdorff(b, a, tolerance=0.01)
    assert (one.forward, one.backward) == (other.backward, other.forward)


def test_is_the_same_on_any_number_of_threads(monkeypatch):
    grid = rtin.Grid(terrains.noise((70, 90)))
    mesh = rtin.coarsen(grid, max_error=20.0)
    found = []
    for n_threads in ("1", "2", "5"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        found.append(rtin.hausdorff(grid, mesh))
    assert found[0] == found[1] == found[2]


def test_coordinates_far_from_zero_come_to_an_end():
    """What is smaller than rounding is not asked for."""
    high = 2.0**40
    found = rtin.hausdorff(lifted(pyramid(3.0), high), lifted(square(), high), tolerance=1e-300)
    assert_bounds(found, 3.0, 1e-12 * high * 1.001)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan])
def test_tolerance_must_be_above_zero(tolerance):
    with pytest.raises(ValueError, match="tolerance must be above zero"):
        rtin.hausdorff(square(), square(1.0), tolerance=tolerance)
