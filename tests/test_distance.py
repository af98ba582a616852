"""`compare`: exact distances, Metro's samples, laws, other people's programs, bad input."""

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import naive
import rtin
import surfaces
import terrains
from meshes import any_mesh, renumbered
from rtin.mesh import TriangleMesh
from surfaces import GRIDS, MESHES, cloud, full, points_around

SAMPLINGS = ["subdivision", "montecarlo", "similar", "vertices"]
ALL = MESHES | GRIDS


def distances(points, surface):
    return rtin.compare(cloud(points), surface, "vertices").forward.field.distances


def largest_coordinate(points, surface):
    there = full(surface).vertices if isinstance(surface, rtin.Grid) else surface.vertices
    return max(abs(points).max(), abs(there).max())


def figures(side):
    return side.max, side.mean, side.rms, side.area_mean, side.area_rms, side.place, side.n_samples


def as_bytes(side):
    return repr(figures(side)), *(values.tobytes() for values in side.field)


# --- from points to surfaces --------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_is_exact_near_and_far(name):
    surface = ALL[name]()
    points = points_around(surface, 12, np.random.default_rng(5))
    atol = 1e-15 * largest_coordinate(points, surface)
    expected = naive.distances(points, surface)
    np.testing.assert_allclose(distances(points, surface), expected, rtol=1e-12, atol=atol)


@pytest.mark.parametrize("name", [name for name in ALL if name != "slivers"])
def test_is_what_libigl_finds(name):
    """But for slivers, where libigl loses digits."""
    igl = pytest.importorskip("igl", exc_type=ImportError)
    surface = ALL[name]()
    points = points_around(surface, 300, np.random.default_rng(6))
    mesh = full(surface) if isinstance(surface, rtin.Grid) else surface
    shift = mesh.vertices[mesh.triangles[0, 0]]
    triangles = mesh.triangles.astype(np.int64)
    there = igl.point_mesh_squared_distance(points - shift, mesh.vertices - shift, triangles)
    atol = 1e-9 * max(1.0, largest_coordinate(points, surface) / 1e5)
    np.testing.assert_allclose(distances(points, surface), np.sqrt(there[0]), rtol=1e-9, atol=atol)


@given(any_mesh, st.integers(0, 2**32 - 1))
def test_is_the_nearest_of_all_triangles_of_any_mesh(mesh, seed):
    points = points_around(mesh, 3, np.random.default_rng(seed))
    atol = 4e-15 * largest_coordinate(points, mesh)
    expected = naive.distances(points, mesh)
    np.testing.assert_allclose(distances(points, mesh), expected, rtol=1e-9, atol=atol)


@given(terrains.rasters(), st.sampled_from(list(surfaces.TRANSFORMS)), st.integers(0, 2**32 - 1))
def test_is_the_nearest_of_all_triangles_of_any_grid(heights, transform, seed):
    grid = rtin.Grid(heights, surfaces.TRANSFORMS[transform])
    points = points_around(grid, 3, np.random.default_rng(seed))
    atol = 4e-15 * largest_coordinate(points, grid)
    expected = naive.distances(points, grid)
    np.testing.assert_allclose(distances(points, grid), expected, rtol=1e-12, atol=atol)


def through_blocks(kind):
    """A surface of many blocks of cells, with nothing in some of them, and cliffs."""
    shape = (150, 210)
    heights = terrains.waves(shape) + 300.0 * (np.indices(shape)[0] > 70)
    holes = terrains.pond(shape) | (np.indices(shape)[1] > 190)
    holes[40:60, 20:50] = True
    grid = rtin.Grid(terrains.pierced(heights, holes), Affine.rotation(20.0) @ Affine.scale(3, -2))
    return grid if kind == "grid" else full(grid)


@pytest.mark.parametrize("kind", ["grid", "mesh"])
def test_finds_what_is_nearest_many_cells_away(kind):
    igl = pytest.importorskip("igl", exc_type=ImportError)
    surface, mesh = through_blocks(kind), through_blocks("mesh")
    rng = np.random.default_rng(8)
    low, high = mesh.bounds
    points = rng.uniform(low - 0.3 * (high - low), high + 0.3 * (high - low), (4000, 3))
    points[::4, 2] *= 30.0
    squares = igl.point_mesh_squared_distance(
        points, mesh.vertices, mesh.triangles.astype(np.int64)
    )[0]
    np.testing.assert_allclose(distances(points, surface), np.sqrt(squares), rtol=1e-11)


@pytest.mark.parametrize("row", [8, 16, 64])
def test_a_wall_between_blocks_belongs_to_both(row):
    heights = np.zeros((97, 97))
    heights[row] = 1000.0
    points = np.array([[48.0, 4.0 - row, 500.0], [48.0, -4.0 - row, 500.0]])
    expected = 3.5 * 1000.0 / np.hypot(1000.0, 1.0)
    np.testing.assert_allclose(distances(points, rtin.Grid(heights)), expected, rtol=1e-12)


def test_a_slope_over_many_blocks_belongs_to_all():
    small = plane(size=40.0, n=25)
    slope = [[0.0, 0.0, -125.0], [40.0, 0.0, 75.0], [20.0, 40.0, -25.0]]
    triangles = np.vstack([[[0, 1, 2]], small.triangles + 3])
    mesh = TriangleMesh(np.vstack([slope, small.vertices]), triangles)
    point = np.array([[39.0, 20.0, 15.0]])  # over the plain, beside the slope
    np.testing.assert_allclose(distances(point, mesh), 55.0 / np.sqrt(26.0), rtol=1e-12)


@pytest.mark.parametrize("sine", [1e-4, 1e-7, 1e-9, 1e-11, 1e-13, 1e-15])
def test_slivers_cost_no_digits(sine):
    rng = np.random.default_rng(2)
    a, b = 100.0 * rng.random((2, 20, 1, 3))
    c = a + rng.random((20, 1, 1)) * (b - a) + sine * 100 * rng.standard_normal((20, 1, 3))
    for corners in np.concatenate([a, b, c], axis=1):
        mesh = TriangleMesh(rng.permutation(corners), [[0, 1, 2]])
        points = rng.dirichlet([1.0, 1.0, 1.0], 4) @ corners
        points[::2] += 100.0 * sine * rng.standard_normal((2, 3))
        expected = naive.distances(points, mesh)
        np.testing.assert_allclose(distances(points, mesh), expected, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("name", GRIDS)
def test_a_grid_is_its_finest_triangles(name):
    grid = GRIDS[name]()
    mesh = full(grid)
    # As far from any other surface, and any other as far from it.
    points = points_around(grid, 200, np.random.default_rng(1))
    atol = 4e-15 * largest_coordinate(points, grid)
    other = rtin.compare(cloud(points), mesh, "vertices")
    np.testing.assert_allclose(distances(points, grid), other.forward.field[1], 1e-12, atol)
    plane = TriangleMesh(points[:3], [[0, 1, 2]])
    for sampling in ("subdivision", "vertices"):
        of_grid, of_mesh = (
            rtin.compare(s, plane, sampling, samples=30_000).forward for s in (grid, mesh)
        )
        assert of_grid.n_samples == pytest.approx(of_mesh.n_samples, rel=0.04)
        assert of_grid.field.areas.sum() == pytest.approx(of_mesh.field.areas.sum(), rel=1e-6)
        if sampling == "vertices":
            np.testing.assert_allclose(
                np.sort(of_grid.field.distances), np.sort(of_mesh.field.distances), 1e-9, atol
            )
            assert figures(of_grid)[:3] == pytest.approx(figures(of_mesh)[:3], rel=1e-9)
        else:
            assert of_grid.max == pytest.approx(of_mesh.max, rel=1e-2)
            assert of_grid.area_mean == pytest.approx(of_mesh.area_mean, rel=1e-2)
            assert of_grid.area_rms == pytest.approx(of_mesh.area_rms, rel=1e-2)


# --- cases whose answer is known ----------------------------------------------------------------


def plane(size=8.0, n=5, slope=0.0, height=0.0, low=0.0):
    """A square of 2 (n-1)² triangles that rises along x."""
    row, col = np.indices((n, n))
    step = size / (n - 1)
    transform = Affine(step, 0.0, low, 0.0, -step, size + low)
    return full(rtin.Grid(height + slope * (col * step + low) + 0.0 * row, transform))


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_parallel_planes_are_as_far_apart_everywhere(sampling):
    result = rtin.compare(plane(n=5), plane(n=9, height=2.5), sampling)
    for side in (result.forward, result.backward):
        np.testing.assert_allclose(side.field.distances, 2.5, rtol=1e-12)
        assert (side.max, side.mean, side.rms) == pytest.approx((2.5, 2.5, 2.5), rel=1e-12)
        if sampling != "vertices":
            assert (side.area_mean, side.area_rms) == pytest.approx((2.5, 2.5), rel=1e-12)
        assert side.quantile(0.5) == pytest.approx(2.5, rel=5e-4)
    assert result.hausdorff == pytest.approx(2.5, rel=1e-12)


def test_a_tilted_plane_rises_from_a_flat_one():
    tilted, flat = plane(slope=0.75), plane(size=40.0, low=-16.0)
    side = rtin.compare(tilted, flat, samples=3000).forward
    assert side.max == pytest.approx(6.0, rel=1e-9)
    assert side.area_mean == pytest.approx(3.0, rel=1e-9)
    assert side.area_rms == pytest.approx(6.0 / np.sqrt(3.0), rel=1e-3)
    assert side.place[0] == 8.0


def test_points_over_a_tilted_plane_are_upright_to_it():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(3.5, 4.5, (50, 2)), np.zeros(50)])
    height = rng.uniform(-2.0, 2.0, 50)
    points[:, 2] = 0.75 * points[:, 0] + height
    np.testing.assert_allclose(distances(points, plane(slope=0.75)), abs(height) * 0.8, atol=1e-12)


def pyramid(height, half=3.0):
    at = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0], [0, 0, height]]
    return TriangleMesh(at, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def test_a_pyramid_stands_on_its_base():
    result = rtin.compare(pyramid(4.0), pyramid(0.0), samples=400)
    assert result.forward.max == pytest.approx(4.0, rel=1e-12)
    assert result.forward.place == (0.0, 0.0, 4.0)
    assert result.forward.area_mean == pytest.approx(4.0 / 3.0, rel=1e-9)
    assert result.backward.max == pytest.approx(4.0 * 3.0 / 5.0, rel=1e-9)
    assert result.backward.place == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert result.hausdorff == result.forward.max


def test_one_spike_on_a_plain():
    heights = np.zeros((9, 9))
    heights[4, 4] = 12.0
    grid, plain = rtin.Grid(heights), rtin.Grid(np.zeros((9, 9)))
    side = rtin.compare(grid, plain, samples=20_000).forward
    mesh = full(grid)
    areas = np.array([naive.area_of(*mesh.vertices[t]) for t in mesh.triangles])
    risen = (mesh.vertices[mesh.triangles, 2] > 0.0).any(axis=1)
    assert (side.max, side.place) == (12.0, (4.0, -4.0, 12.0))
    assert side.area_mean == pytest.approx(4.0 * areas[risen].sum() / areas.sum(), rel=2e-3)


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize("name", ALL)
def test_a_surface_is_no_distance_from_itself(name, sampling):
    surface = ALL[name]()
    result = rtin.compare(surface, surface, sampling, samples=2000)
    points = result.forward.field.points
    assert result.hausdorff <= 2e-15 * largest_coordinate(points, surface)
    assert as_bytes(result.forward) == as_bytes(result.backward)


def test_a_triangle_against_a_point():
    triangle = TriangleMesh([[0, 0, 0], [4, 0, 0], [0, 3, 0]], [[0, 1, 2]])
    result = rtin.compare(triangle, cloud(np.array([[0.0, 0.0, 12.0]])))
    assert result.forward.max == pytest.approx(np.hypot(4.0, 12.0), rel=1e-12)
    assert result.backward.max == pytest.approx(12.0, rel=1e-12)
    assert result.backward.n_samples == 1
    assert np.isnan(result.backward.area_mean)


def test_surfaces_side_by_side_are_measured_all_the_same():
    there = plane(n=3).vertices + np.array([1e5, 0.0, 0.0])
    result = rtin.compare(plane(n=3), TriangleMesh(there, plane(n=3).triangles))
    assert result.forward.max == pytest.approx(1e5, rel=1e-12)
    assert result.backward.max == pytest.approx(1e5, rel=1e-12)
    assert result.forward.place[0] == pytest.approx(0.0, abs=1e-9)


# --- laws ---------------------------------------------------------------------------------------


def two_surfaces():
    grid = surfaces.grid((33, 41), "pond")
    return rtin.coarsen(grid, max_error=8.0), grid


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_is_symmetric(sampling):
    a, b = two_surfaces()
    one, other = rtin.compare(a, b, sampling, seed=3), rtin.compare(b, a, sampling, seed=3)
    assert as_bytes(one.forward) == as_bytes(other.backward)
    assert as_bytes(one.backward) == as_bytes(other.forward)


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_number_of_threads_changes_no_byte(sampling, monkeypatch):
    grid = rtin.samples.topobathy()
    mesh = rtin.coarsen(grid, max_error=20.0)
    results = []
    for n_threads in ("1", "2"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        result = rtin.compare(mesh, grid, sampling, samples=mesh.n_triangles * 2)
        results.append([as_bytes(result.forward), as_bytes(result.backward)])
    assert results[0] == results[1]


def moved(mesh, matrix, shift=(0.0, 0.0, 0.0)):
    return TriangleMesh(mesh.vertices @ np.transpose(matrix) + shift, mesh.triangles)


def test_turning_space_changes_no_distance():
    a, b = surfaces.soup(seed=1), surfaces.soup(seed=2, n=40)
    rotation = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    for sampling in SAMPLINGS:
        before = rtin.compare(a, b, sampling)
        after = rtin.compare(
            *(moved(mesh, rotation, (7.0, -3.0, 900.0)) for mesh in (a, b)), sampling
        )
        for one, other in [(before.forward, after.forward), (before.backward, after.backward)]:
            np.testing.assert_allclose(one.field.distances, other.field.distances, atol=1e-11)
            assert figures(one)[:3] == pytest.approx(figures(other)[:3], rel=1e-9)


def test_scaling_space_scales_distances():
    a, b = surfaces.soup(seed=1), surfaces.soup(seed=2, n=40)
    for factor in (1e-6, 8.0, 1e6):
        scaled = rtin.compare(moved(a, factor * np.eye(3)), moved(b, factor * np.eye(3)))
        for one, other in zip((scaled.forward, scaled.backward), _sides(a, b), strict=True):
            np.testing.assert_allclose(one.field.distances, factor * other.field.distances, 1e-9)
            assert one.area_mean == pytest.approx(factor * other.area_mean, rel=1e-9)


def _sides(a, b):
    result = rtin.compare(a, b)
    return result.forward, result.backward


def test_numbering_changes_no_distance():
    rng = np.random.default_rng(3)
    a, b = surfaces.soup(seed=1), rtin.coarsen(surfaces.grid((17, 23), "pond"), max_error=6.0)
    before = rtin.compare(a, b, "vertices")
    after = rtin.compare(renumbered(a, rng), renumbered(b, rng), "vertices")
    for one, other in [(before.forward, after.forward), (before.backward, after.backward)]:
        np.testing.assert_allclose(
            np.sort(one.field.distances), np.sort(other.field.distances), rtol=1e-12, atol=1e-14
        )
        assert figures(one)[:3] == pytest.approx(figures(other)[:3], rel=1e-12)
        assert one.place == pytest.approx(other.place, rel=1e-12)
    smooth = rtin.compare(renumbered(a, rng), renumbered(b, rng), samples=20_000)
    assert smooth.forward.area_mean == pytest.approx(
        rtin.compare(a, b, samples=20_000).forward.area_mean, rel=1e-2
    )


def test_vertices_without_a_triangle_are_no_part_of_a_surface():
    a, b = two_surfaces()
    strays = [[1e9, 0.0, 0.0], [np.nan, np.nan, np.nan], [0.0, np.inf, 1.0]]
    more = TriangleMesh(np.vstack([strays, a.vertices]), a.triangles + 3)
    plain, strayed = rtin.compare(a, b), rtin.compare(more, b)
    assert as_bytes(plain.forward) == as_bytes(strayed.forward)
    assert as_bytes(plain.backward) == as_bytes(strayed.backward)


# --- what is said of the samples ----------------------------------------------------------------


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_figures_are_those_of_the_field(sampling):
    a, b = two_surfaces()
    for side in _sides_of(rtin.compare(a, b, sampling)):
        points, far, areas = side.field
        assert len(points) == len(far) == len(areas) == side.n_samples
        assert side.max == far.max()
        assert side.place == tuple(points[far.argmax()])
        assert side.mean == pytest.approx(far.mean(), rel=1e-12)
        assert side.rms == pytest.approx(np.sqrt((far**2).mean()), rel=1e-12)
        if sampling == "vertices":
            assert not areas.any()
            assert np.isnan([side.area_mean, side.area_rms]).all()
        else:
            mean, square = np.average(far, weights=areas), np.average(far**2, weights=areas)
            assert side.area_mean == pytest.approx(mean, rel=1e-12)
            assert side.area_rms == pytest.approx(np.sqrt(square), rel=1e-12)


def _sides_of(result):
    return result.forward, result.backward


def test_the_first_of_equally_far_samples_is_the_place():
    heights = np.zeros((300, 200))
    heights[[40, 40, 290], [150, 20, 3]] = 5.0
    side = rtin.compare(rtin.Grid(heights), rtin.Grid(np.zeros((300, 200))), "vertices").forward
    assert side.place == (20.0, -40.0, 5.0)
    points = np.zeros((3000, 3))  # of many pieces
    points[:, 2] = -5.0
    points[0, 2] = 5.0
    side = rtin.compare(cloud(points), cloud(np.zeros((1, 3))), "vertices").forward
    assert side.place == (0.0, 0.0, 5.0)


def test_quantiles_are_within_a_thousandth_of_numpys():
    a, b = two_surfaces()
    for side in _sides_of(rtin.compare(a, b)):
        shares = np.linspace(0.0, 1.0, 101)
        ours = np.array([side.quantile(share) for share in shares])
        theirs = np.quantile(side.field.distances, shares, method="inverted_cdf")
        np.testing.assert_allclose(ours, theirs, rtol=5e-4, atol=1e-37)
        assert (np.diff(ours) >= 0.0).all()
        assert ours[-1] <= side.max


@pytest.mark.parametrize("share", [-0.1, 1.5, np.nan])
def test_quantiles_are_of_shares(share):
    side = rtin.compare(plane(), plane()).forward
    with pytest.raises(ValueError, match="a share between 0 and 1 is wanted, got"):
        side.quantile(share)


def test_says_how_far_both_ways():
    text = repr(rtin.compare(plane(n=2), plane(n=2, height=2.5), "vertices"))
    assert text == (
        "<SurfaceDistance forward max 2.5, rms 2.5, mean 2.5 over 4 samples; "
        "backward max 2.5, rms 2.5, mean 2.5 over 4 samples>"
    )


@pytest.mark.parametrize("n_threads", ["1", "2"])
def test_progress_climbs_to_one(n_threads, monkeypatch):
    monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
    told = []
    rtin.compare(*two_surfaces(), progress=told.append)
    assert told[-1] == 1.0
    assert len(told) > 4
    assert (np.diff(told) > 0.0).all()


def test_bounds_hold_what_samples_find():
    a, b = rtin.coarsen(surfaces.grid((7, 6), "corner"), max_error=9.0), surfaces.soup(9)
    bounds, found = rtin.hausdorff(a, b), rtin.compare(a, b, samples=500)
    assert found.hausdorff <= bounds.upper * (1.0 + 1e-12)
    assert bounds.lower <= bounds.upper
    grid = surfaces.grid((5, 4), "corner")
    assert rtin.hausdorff(a, grid).forward.upper >= rtin.compare(a, grid).forward.max * 0.999999


# --- coordinate reference systems ---------------------------------------------------------------


def test_degrees_count_as_metres_about_the_middle():
    step = 1.0 / 1200.0
    transform = Affine(step, 0.0, 15.0, 0.0, -step, 60.0)
    low, high = (rtin.Grid(np.full((5, 5), z), transform, "EPSG:4326") for z in (0.0, 2.5))
    assert rtin.compare(low, high).hausdorff == pytest.approx(2.5, rel=1e-12)
    east = rtin.Grid(low.heights, Affine.translation(0.1, 0.0) @ transform, "EPSG:4326")
    result = rtin.compare(low, east)
    gap = 111_320.0 * np.cos(np.radians(60.0)) * (0.1 - 0.0)
    assert result.forward.max == pytest.approx(gap, rel=0.01)
    assert result.forward.place[:2] == pytest.approx((15.0, 60.0), abs=0.01)
    assert result.forward.field.points[:, 0].min() == pytest.approx(15.0, abs=1e-12)


def test_an_unknown_crs_is_taken_to_be_the_other_ones():
    mesh = plane()
    known = TriangleMesh(mesh.vertices + np.array([0.0, 0.0, 1.0]), mesh.triangles, "EPSG:32633")
    assert rtin.compare(mesh, known).hausdorff == pytest.approx(1.0, rel=1e-12)
    assert rtin.compare(known, known).hausdorff <= 1e-12


# --- other people's programs --------------------------------------------------------------------


def of_meshlab(source, target, n_samples):
    """What MeshLab finds in faces alone, by Monte Carlo, at vertices alone, and everywhere."""
    pymeshlab = pytest.importorskip("pymeshlab", exc_type=ImportError)
    meshes = pymeshlab.MeshSet(verbose=False)
    for mesh in (source, target):
        meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.triangles))

    def measured(**of):
        everywhere = pymeshlab.PercentageValue(100.0)
        return meshes.get_hausdorff_distance(
            sampledmesh=0, targetmesh=1, samplenum=n_samples, maxdist=everywhere, **of
        )

    return (
        measured(samplevert=False, sampleedge=False, sampleface=True),
        measured(samplevert=True, sampleedge=False, sampleface=False),
        measured(samplevert=True, sampleedge=True, sampleface=True),
    )


@pytest.mark.parametrize("way", ["forward", "backward"])
def test_is_what_meshlab_finds(way):
    grid = rtin.Grid(terrains.waves((129, 129)), Affine.scale(20.0, -20.0))
    fine, coarse = full(grid), rtin.coarsen(grid, max_error=6.0)
    a, b = (coarse, fine) if way == "forward" else (fine, coarse)
    n_samples = 10 * fine.n_triangles
    in_faces, at_vertices, anywhere = of_meshlab(a, b, n_samples)
    side = rtin.compare(a, b, "montecarlo", samples=n_samples).forward
    assert side.max == pytest.approx(anywhere["max"], rel=0.01)
    assert side.area_mean == pytest.approx(in_faces["mean"], rel=0.01)
    assert side.area_rms == pytest.approx(in_faces["RMS"], rel=0.01)
    ours = rtin.compare(a, b, "vertices").forward
    theirs = [at_vertices[name] for name in ("max", "mean", "RMS")]
    assert figures(ours)[:3] == pytest.approx(theirs, rel=1e-4, abs=1e-4)


# --- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        (np.zeros((3, 3)), TypeError, "must be a TriangleMesh or a Grid, got ndarray"),
        (None, TypeError, "must be a TriangleMesh or a Grid, got NoneType"),
        (
            TriangleMesh(np.zeros((3, 3)), np.empty((0, 3), int)),
            ValueError,
            "must have triangles, got a mesh without",
        ),
        (TriangleMesh([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]]), ValueError, "at 1$"),
        (TriangleMesh([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]]), ValueError, "at 2$"),
        (rtin.Grid([[1.0, np.nan], [np.nan, 1.0]]), ValueError, "without three neighbouring"),
    ],
)
def test_wants_surfaces(wrong, error, message):
    for name, pair in (("mesh_a", (wrong, plane())), ("mesh_b", (plane(), wrong))):
        with pytest.raises(error, match=f"^{name} .*{message}"):
            rtin.compare(*pair)


def test_a_quantile_is_of_the_rank_that_its_share_says():
    stairs = rtin.Grid(np.arange(1.0, 101.0).reshape(10, 10))
    corners = [[-999.0, -999.0, 0.0], [999.0, -999.0, 0.0], [0.0, 999.0, 0.0]]
    floor = TriangleMesh(np.array(corners), np.array([[0, 1, 2]], np.int32))
    found = rtin.compare(stairs, floor, "vertices").forward
    for rank in range(1, 101):
        assert found.quantile(rank / 100) == pytest.approx(rank, rel=6e-4), rank


@pytest.mark.parametrize("measure", [rtin.compare, rtin.hausdorff, rtin.terrain_difference])
@pytest.mark.parametrize("scale", [(1e55, 1e55, 1.0), (1.0, 1.0, 1e55), (1e160, 1e160, 1e160)])
def test_refuses_surfaces_whose_products_overflow(measure, scale):
    mesh = plane()
    vertices = (mesh.vertices + np.array([0.0, 0.0, 1.0])) * scale
    with pytest.raises(ValueError, match=r"^surfaces must be smaller than 1e\+50, got 1.*e\+\d+$"):
        measure(TriangleMesh(vertices, mesh.triangles), mesh)


def test_refuses_unlike_crs():
    mesh = plane()
    a, b = (TriangleMesh(mesh.vertices, mesh.triangles, f"EPSG:{n}") for n in (32633, 4326))
    with pytest.raises(ValueError, match="same CRS, got EPSG:32633 and EPSG:4326; reproject"):
        rtin.compare(a, b)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"sampling": "poisson"}, ValueError, "subdivision, .*, vertices, got 'poisson'"),
        ({"sampling": None}, ValueError, "sampling must be one of subdivision, .*, got None"),
        ({"samples": 0}, ValueError, "samples must be 1 or more, got 0"),
        ({"samples": 10**400}, ValueError, "samples must be 1000000000000000 or fewer, got 1000"),
        ({"samples": 1e4}, TypeError, "samples must be a whole number, got 10000.0"),
        ({"samples": True}, TypeError, "samples must be a whole number, got True"),
        ({"seed": -1}, ValueError, "seed must be 0 or more, got -1"),
        ({"seed": "1"}, TypeError, "seed must be a whole number, got '1'"),
    ],
)
def test_wants_sensible_options(options, error, message):
    with pytest.raises(error, match=message) as caught:
        rtin.compare(plane(), plane(), **options)
    assert "\n" not in str(caught.value)
