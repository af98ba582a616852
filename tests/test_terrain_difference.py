"""Differences of terrains: exact against a slow twin, and by what volumes and angles must do."""

from dataclasses import astuple

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

UP = Affine.scale(1.0)  # y runs with the rows


def flat(height=0.0, side=8.0, west=0.0, south=0.0):
    x, y = west + np.array([0, side, side, 0]), south + np.array([0, 0, side, side])
    return TriangleMesh(np.column_stack([x, y, np.full(4, height)]), [[0, 1, 2], [0, 2, 3]])


def pyramid(height, side=8.0):
    corners = np.array([(0, 0, 0), (side, 0, 0), (side, side, 0), (0, side, 0)])
    vertices = np.vstack([corners, (side / 2, side / 2, height)])
    return TriangleMesh(vertices, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def shifted(mesh, x, y, z=0.0):
    return TriangleMesh(mesh.vertices + np.array([x, y, z]), mesh.triangles)


def cloud(rng, n=9, size=6.0):
    """A Delaunay mesh of some points; heights and places are short numbers."""
    points = np.unique(rng.integers(0, 16 * size, (n, 2)) / 16, axis=0)
    heights = rng.integers(-32, 32, len(points)) / 8.0
    return TriangleMesh(np.column_stack([points, heights]), Delaunay(points).simplices)


def raster(rng):
    heights = rng.integers(-8, 8, (4, 5)) / 4.0
    heights[rng.random((4, 5)) < 0.1] = np.nan
    heights[:2, :2] = 1.0
    return rtin.Grid(heights, Affine(1.5, 0.25, -0.5, -0.5, 1.25, 2.0))


def terrain(rng):
    return raster(rng) if rng.random() < 0.4 else cloud(rng)


def rough_pair(seed):
    rng = np.random.default_rng(seed)
    return cloud(rng), terrain(rng)


def close(value, **within):
    return pytest.approx(value, **{"rel": 1e-11, "abs": 1e-11, **within})


# --- against the twin ---------------------------------------------------------------------------


@settings(max_examples=40)
@given(seeds)
def test_is_the_sum_over_all_pairs_of_triangles(seed):
    a, b = rough_pair(seed)
    area, fill, cut, largest, smallest = naive.terrain_difference(a, b)
    if area == 0.0:
        with pytest.raises(ValueError, match="in common"):
            rtin.terrain_difference(a, b)
        return
    found = rtin.terrain_difference(a, b)
    assert (found.area, found.fill, found.cut) == close((area, fill, cut))
    assert (found.max, found.min) == close((largest, smallest), rel=1e-9, abs=1e-9)
    assert found.net == close(fill - cut)
    assert found.mean == close((fill - cut) / area)
    assert found.mean_abs == close((fill + cut) / area)


@given(terrains.rasters(largest=9), st.sampled_from(list(terrains.TRANSFORMS)), terrains.tolerances)
def test_extremes_of_a_coarsened_mesh_are_its_vertical_error(heights, transform, max_error):
    grid = rtin.Grid(heights, terrains.TRANSFORMS[transform])
    mesh = rtin.coarsen(grid, max_error=max_error)
    error = rtin.vertical_error(mesh, grid)
    for found in (rtin.terrain_difference(grid, mesh), rtin.terrain_difference(mesh, grid)):
        assert max(found.max, -found.min) == close(error.max, abs=1e-7)
        assert found.area_only_a == close(0.0, abs=1e-6)
        assert found.area_only_b == close(0.0, abs=1e-6)
        assert found.area == close(np.abs(mesh.signed_areas()).sum(), rel=1e-8)


def test_moments_are_those_of_many_samples():
    rng = np.random.default_rng(3)
    one = rtin.Grid(rng.normal(0, 2, (9, 9)).astype(np.float32), UP)
    other = rtin.Grid(rng.normal(0, 2, (5, 5)).astype(np.float32), Affine.scale(2.0))
    x, y = rng.uniform(0, 8, (2, 200_000))
    gaps = other.heights_at(np.column_stack([x, y])) - one.heights_at(np.column_stack([x, y]))
    found = rtin.terrain_difference(one, other)
    assert found.mean == pytest.approx(gaps.mean(), abs=0.05)
    assert found.rms == pytest.approx(np.sqrt((gaps**2).mean()), rel=0.05)


# --- exact cases --------------------------------------------------------------------------------


def test_of_a_pyramid_and_its_base():
    found = rtin.terrain_difference(flat(), pyramid(3.0))
    assert found.fill == close(64.0)  # a third of base times height
    assert found.cut == 0.0
    assert (found.max, found.min, found.area) == close((3.0, 0.0, 64.0))
    assert found.rms == close(np.sqrt(9.0 / 6.0))
    assert found.place_of_max == (4.0, 4.0)
    slope = np.degrees(np.arctan(0.75))
    assert found.normals == close((slope, slope, slope))
    assert found.slope == close((slope, slope, slope))


@pytest.mark.parametrize(("x", "y"), [(0.5, 0.0), (-1.0, 2.0), (0.0, 3.0)])
def test_of_tilted_planes(x, y):
    base = flat()
    rise = base.vertices[:, 0] * x + base.vertices[:, 1] * y
    tilted = TriangleMesh(base.vertices + np.outer(rise, (0, 0, 1)), [[0, 1, 3], [1, 2, 3]])
    found = rtin.terrain_difference(base, tilted)
    slope = np.degrees(np.arctan(np.hypot(x, y)))
    assert found.net == close(64.0 * (4.0 * x + 4.0 * y))
    assert (found.max, found.min) == close((rise.max(), rise.min()))
    assert found.normals == close((slope, slope, slope))
    assert found.slope == close((slope, slope, slope))


def test_opposite_tilts_differ_in_normals_but_not_in_slope():
    base = flat()
    rise = np.outer(base.vertices[:, 0], (0, 0, 0.5))
    one = TriangleMesh(base.vertices + rise, base.triangles)
    other = TriangleMesh(base.vertices - rise, base.triangles)
    found = rtin.terrain_difference(one, other)
    assert found.normals.mean == close(2.0 * np.degrees(np.arctan(0.5)))
    assert found.slope == close((0.0, 0.0, 0.0))


def test_cut_and_fill_are_told_apart_at_the_zero_line():
    """A roof over a plane at a third of its height."""
    heights = np.tile([0.0, 3.0, 0.0], (2, 1))
    roof = rtin.Grid(heights, Affine.scale(2.0))
    level = flat(1.0, side=4.0)
    level = TriangleMesh(level.vertices * (1, 0.5, 1), level.triangles)
    found = rtin.terrain_difference(level, roof)
    assert found.fill == close(2.0 * 0.5 * (2.0 * 4.0 / 3.0) * 2.0)
    assert found.cut == close(2.0 * 2.0 * 0.5 * 1.0 * (2.0 / 3.0))


def test_of_a_step_as_steep_as_a_box():
    """Upright triangles count for nothing; on each side of them is another height."""
    left, right = flat(0.0, side=2.0), flat(5.0, side=2.0, west=2.0)
    wall = [[1, 4, 7], [1, 7, 2]]
    vertices = np.vstack([left.vertices, right.vertices])
    step = TriangleMesh(vertices, np.vstack([left.triangles, right.triangles + 4, wall]))
    found = rtin.terrain_difference(flat(1.0, side=4.0), step)
    assert (found.fill, found.cut, found.area) == close((16.0, 4.0, 8.0))
    assert found.area_only_a == close(8.0)
    assert found.area_only_b == close(0.0)
    assert found.normals.max == found.slope.max == 0.0


def test_covers_what_both_do():
    found = rtin.terrain_difference(flat(side=8.0), flat(1.0, side=8.0, west=6.0, south=-1.0))
    assert found.area == close(14.0)
    assert (found.area_only_a, found.area_only_b) == close((50.0, 50.0))
    assert (found.max, found.min, found.fill) == close((1.0, 1.0, 14.0))


def test_overlaps_are_counted_as_often_as_they_cover_a_place():
    one = flat(2.0)
    twice = TriangleMesh(one.vertices, np.vstack([one.triangles, one.triangles[:, ::-1]]))
    found = rtin.terrain_difference(flat(), twice)
    assert (found.fill, found.area) == close((256.0, 128.0))
    assert found.area_only_a == 0.0


def test_voids_of_a_grid_are_not_covered():
    heights = np.zeros((9, 9))
    heights[4, 4] = np.nan
    holed = rtin.Grid(heights, UP)
    found = rtin.terrain_difference(flat(1.0), holed)
    lost = 64.0 - found.area
    assert 2.0 <= lost <= 4.0  # the triangles around one sample
    assert found.area_only_a == close(lost)
    assert found.cut == close(found.area)


def test_degrees_are_measured_in_metres():
    level = TriangleMesh(flat().vertices * (1e-3, 1e-3, 1), flat().triangles, "EPSG:4326")
    other = TriangleMesh(level.vertices + np.array([0, 0, 2.0]), level.triangles, "EPSG:4326")
    found = rtin.terrain_difference(level, other)
    assert found.area == pytest.approx((8e-3 * 111_000) ** 2, rel=0.01)
    assert found.fill == close(2.0 * found.area)


# --- laws ---------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(seeds)
def test_turning_both_round_swaps_cut_and_fill(seed):
    a, b = rough_pair(seed)
    if naive.terrain_difference(a, b)[0] == 0.0:
        return
    there, back = rtin.terrain_difference(a, b), rtin.terrain_difference(b, a)
    assert (there.fill, there.cut, there.mean) == close((back.cut, back.fill, -back.mean))
    assert (there.max, there.min) == close((-back.min, -back.max), rel=1e-9, abs=1e-9)
    assert (there.rms, there.mean_abs) == close((back.rms, back.mean_abs))
    assert there.normals == close(back.normals, rel=1e-9, abs=1e-6)
    assert there.slope.mean == close(-back.slope.mean, abs=1e-6)
    assert there.slope[1:] == close(back.slope[1:], abs=1e-6)
    assert (there.area_only_a, there.area_only_b) == close((back.area_only_b, back.area_only_a))


def test_net_volumes_add_up():
    grid = rtin.Grid(terrains.waves((33, 33)), UP)
    meshes = [rtin.coarsen(grid, max_error=error) for error in (1.0, 5.0, 20.0)]
    one, two, three = meshes
    direct = rtin.terrain_difference(one, three).net
    assert direct == close(
        rtin.terrain_difference(one, two).net + rtin.terrain_difference(two, three).net, abs=1e-8
    )


@pytest.mark.parametrize(("x", "y", "z"), [(1000.0, -250.0, 0.0), (431_207.5, 5.4e6, 512.0)])
def test_moving_both_changes_places_only(x, y, z):
    one, other = cloud(np.random.default_rng(5)), cloud(np.random.default_rng(6))
    here = rtin.terrain_difference(one, other)
    there = rtin.terrain_difference(shifted(one, x, y, z), shifted(other, x, y, z))
    assert (there.fill, there.cut, there.rms) == close((here.fill, here.cut, here.rms), rel=1e-8)
    assert there.normals == close(here.normals, rel=1e-7)
    assert np.subtract(there.place_of_max, here.place_of_max) == close((x, y), abs=1e-6)


def test_raising_one_raises_the_difference():
    one, other = cloud(np.random.default_rng(7)), cloud(np.random.default_rng(8))
    low, high = (rtin.terrain_difference(one, shifted(other, 0, 0, z)) for z in (0.0, 2.5))
    assert high.mean == close(low.mean + 2.5)
    assert high.max == close(low.max + 2.5)
    assert high.place_of_max == low.place_of_max
    assert high.normals == low.normals


def test_of_a_mesh_and_itself_is_nothing():
    for shape in (terrains.noise((20, 33)), terrains.cliff((17, 9))):
        grid = rtin.Grid(shape, terrains.TRANSFORMS["rotated"])
        found = rtin.terrain_difference(grid, grid)
        assert (found.max, found.min, found.fill, found.cut) == close((0, 0, 0, 0), abs=1e-9)
        assert found.normals.max == close(0.0, abs=1e-6)
        assert found.area_only_a == close(0.0, abs=1e-6)


def test_is_the_same_on_any_number_of_threads(monkeypatch):
    grid = rtin.Grid(terrains.noise((90, 300)), UP)
    pairs = [(grid, rtin.coarsen(grid, max_error=error)) for error in (5.0, 30.0)]
    pairs.append((pairs[0][1], pairs[1][1]))
    found = []
    for n_threads in ("1", "2", "5"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        found.append([astuple(rtin.terrain_difference(*pair)) for pair in pairs])
    assert found[0] == found[1] == found[2]


def test_tells_its_progress():
    told = []
    grid = rtin.Grid(terrains.noise((40, 40)))
    rtin.terrain_difference(grid, rtin.coarsen(grid, max_error=9.0), progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_says_what_it_found():
    text = repr(rtin.terrain_difference(flat(), pyramid(3.0)))
    assert text.startswith("<TerrainDifference 0 to 3, mean 1, rms 1.22474; fill 64, cut 0 over 64")


# --- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize("west", [8.0, 9.0, 1e6])
def test_terrains_must_have_an_area_in_common(west):
    with pytest.raises(ValueError, match="area in common"):
        rtin.terrain_difference(flat(), flat(west=west))


def test_terrains_must_be_meshes_or_grids():
    with pytest.raises(TypeError, match="mesh_b must be a TriangleMesh or a Grid, got ndarray"):
        rtin.terrain_difference(flat(), np.zeros((3, 3)))


def test_terrains_must_have_triangles():
    with pytest.raises(ValueError, match="mesh_a must have triangles"):
        rtin.terrain_difference(TriangleMesh(np.zeros((3, 3)), np.empty((0, 3), int)), flat())


def test_terrains_must_have_the_same_crs():
    one, other = (TriangleMesh(flat().vertices, flat().triangles, c) for c in (32633, 32632))
    with pytest.raises(ValueError, match="same CRS"):
        rtin.terrain_difference(one, other)
