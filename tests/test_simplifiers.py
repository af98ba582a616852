"""Other people's simplifiers: what they are asked for, what comes back, what they can't do."""

import itertools
import math
import sys

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import rtin
import terrains
from rtin import _merging, simplifiers, validity
from rtin.simplifiers import SIMPLIFIERS, NotInstalled, NotSuited

OWN = ["rtin", "threshold", "subsample"]
TAKES_VOIDS = [*OWN, "quadric", "vtk-quadric", "meshoptimizer", "decimate-pro"]
AT_SAMPLES = [
    "rtin",
    "threshold",
    "martini",
    "delatin",
    "meshoptimizer",
    "decimate-pro",
    "subsample",
]
MODULES = {
    "martini": "pymartini",
    "delatin": "pydelatin",
    "quadric": "fast_simplification",
    "vtk-quadric": "pyvista",
    "meshoptimizer": "meshoptimizer",
    "decimate-pro": "pyvista",
    "angle-merge": "scipy",
}


def rough(shape, seed=3):
    return terrains.waves(shape) + np.round(3.2 * terrains.noise(shape, seed)) / 16.0


GRIDS = {
    "square": rtin.Grid(rough((17, 17)), terrains.TRANSFORMS["oblong cells"]),
    "rotated": rtin.Grid(rough((17, 17)), terrains.TRANSFORMS["rotated"], "EPSG:32633"),
    "oblong": rtin.Grid(rough((13, 24)), terrains.TRANSFORMS["south up"]),
    "degrees": rtin.Grid(rough((17, 17)), Affine(0.001, 0, 11.0, 0, -0.001, 47.0), "EPSG:4326"),
    "float64": rtin.Grid(rough((17, 17)) + 1e-9),
}
WITH_VOIDS = rtin.Grid(terrains.pierced(rough((20, 27)), terrains.pond((20, 27))))


def made(grid, name, **option):
    try:
        return simplifiers.simplified(grid, name, **option)
    except NotInstalled as reason:
        pytest.skip(str(reason))
    except NotSuited as reason:
        assert name == "martini"
        assert min(grid.shape) != max(grid.shape)
        pytest.skip(str(reason))


def require_sound(mesh, grid):
    """What holds of every simplifier's mesh."""
    assert mesh.crs == grid.crs
    assert np.isfinite(mesh.vertices).all()
    assert (mesh.signed_areas() > 0.0).all()
    assert np.unique(mesh.triangles).size == mesh.n_vertices
    places = grid.places(mesh.vertices[:, :2])
    assert (places > -1.0).all()
    assert (places < grid.shape).all()


# --- what is asked for --------------------------------------------------------------------------


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
@pytest.mark.parametrize("name", SIMPLIFIERS)
def test_a_number_of_vertices_is_never_exceeded_and_nearly_reached(name, grid):
    found = made(grid, name, max_vertices=120)
    require_sound(found.mesh, grid)
    assert found.mesh.n_vertices <= 120
    assert found.mesh.n_vertices >= {"subsample": 80}.get(name, 112)
    assert found.seconds > 0.0


@pytest.mark.parametrize("grid", [GRIDS["rotated"], GRIDS["degrees"]], ids=["rotated", "degrees"])
@pytest.mark.parametrize("name", SIMPLIFIERS)
def test_an_error_is_kept_at_every_sample_covered(name, grid):
    found = made(grid, name, max_error=25.0)
    require_sound(found.mesh, grid)
    error = rtin.vertical_error(found.mesh, grid)
    assert error.max <= 25.0 + 1e-4 * (name == "delatin")
    assert found.mesh.n_vertices < 0.9 * grid.n_samples or name == "subsample"


@pytest.mark.parametrize("name", TAKES_VOIDS)
def test_voids_are_no_terrain(name):
    mesh = made(WITH_VOIDS, name, max_vertices=350).mesh
    require_sound(mesh, WITH_VOIDS)
    covered = mesh.signed_areas().sum()
    whole = simplifiers.full_mesh(WITH_VOIDS).signed_areas().sum()
    assert whole < 0.9 * 19 * 26
    assert 0.75 * whole < covered < 1.05 * whole


@pytest.mark.parametrize("name", AT_SAMPLES)
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_those_that_keep_samples_keep_their_heights_and_places(name, grid):
    mesh = made(grid, name, max_vertices=120).mesh
    places = grid.places(mesh.vertices[:, :2])
    row, col = places.astype(int).T
    assert np.array_equal(places, np.column_stack([row, col]))
    assert mesh.vertices[:, 2].tolist() == grid.heights[row, col].tolist()


@pytest.mark.parametrize("name", SIMPLIFIERS)
def test_all_vertices_are_all_samples_and_no_error(name):
    grid = GRIDS["square"]
    mesh = made(grid, name, max_vertices=grid.n_samples).mesh
    assert mesh.n_vertices >= grid.n_samples - (name == "delatin")  # it ends where no error is left
    assert rtin.vertical_error(mesh, grid).max == 0.0


@pytest.mark.parametrize("name", SIMPLIFIERS)
def test_the_same_grid_gives_the_same_bytes(name):
    one, again = (made(GRIDS["degrees"], name, max_vertices=100).mesh for _ in range(2))
    assert one.vertices.tobytes() == again.vertices.tobytes()
    assert one.triangles.tobytes() == again.triangles.tobytes()


@given(st.data())
def test_our_own_take_any_raster(data):
    grid = rtin.Grid(data.draw(terrains.rasters()))
    name, error = data.draw(st.sampled_from(OWN)), data.draw(terrains.tolerances)
    try:
        mesh = simplifiers.simplify(grid, name, max_error=error)
    except NotSuited:
        assert name == "subsample"  # half a cell of the lattice may lie between voids
        return
    assert rtin.vertical_error(mesh, grid).max <= error
    assert validity.complaints(mesh) == []


# --- what each of them does ---------------------------------------------------------------------


def test_the_least_mesh_and_the_threshold_are_those_of_coarsen():
    grid = GRIDS["rotated"]
    least = simplifiers.simplify(grid, "rtin", max_error=12.0)
    assert least.triangles.tobytes() == rtin.coarsen(grid, max_error=12.0).triangles.tobytes()
    found = simplifiers.simplified(grid, "threshold", max_vertices=90)
    assert found.knob == "tolerance"
    again = rtin.coarsen(grid, threshold=found.setting)
    assert found.mesh.triangles.tobytes() == again.triangles.tobytes()


@pytest.mark.parametrize("limit", [30, 60, 61, 150, 280])
def test_no_threshold_comes_nearer_to_a_number_of_vertices(limit):
    grid = GRIDS["square"]
    errors = rtin.vertex_errors(grid)
    counts = [rtin.coarsen(grid, threshold=float(e)).n_vertices for e in np.unique(errors)[:-1]]
    best = max(count for count in counts if count <= limit)
    assert limit >= simplifiers.simplify(grid, "threshold", max_vertices=limit).n_vertices >= best


def test_martini_finds_the_vertices_of_the_threshold():
    grid = GRIDS["square"]
    ours = simplifiers.simplify(grid, "threshold", max_vertices=90)
    theirs = made(grid, "martini", max_vertices=90).mesh
    assert {*map(tuple, ours.vertices.tolist())} == {*map(tuple, theirs.vertices.tolist())}


@pytest.mark.parametrize("limit", [4, 20, 100, 200])
def test_subsampling_takes_the_smallest_step_that_fits(limit):
    grid = GRIDS["oblong"]
    found = simplifiers.simplified(grid, "subsample", max_vertices=limit)
    rows, cols = grid.shape
    counts = {
        step: (math.ceil((rows - 1) / step) + 1) * (math.ceil((cols - 1) / step) + 1)
        for step in range(1, cols)
    }
    assert found.mesh.n_vertices == counts[found.setting] <= limit
    assert all(count > limit for step, count in counts.items() if step < found.setting)
    validity.check(found.mesh)
    assert rtin.vertical_error(found.mesh, grid).n_uncovered == 0


@pytest.mark.parametrize("name", ["quadric", "vtk-quadric", "meshoptimizer", "decimate-pro"])
def test_the_unit_of_length_changes_no_more_than_the_order_of_ties(name):
    heights = rough((17, 17))
    one = rtin.Grid(heights, Affine(8.0, 0, 0, 0, -8.0, 0))
    large = rtin.Grid(heights * 1024.0, Affine(8192.0, 0, 4096.0, 0, -8192.0, 0))
    small, big = (made(grid, name, max_vertices=100).mesh for grid in (one, large))
    assert abs(big.n_vertices - small.n_vertices) <= 2
    error, of_big = (
        rtin.vertical_error(mesh, grid).rms for mesh, grid in ((small, one), (big, large))
    )
    assert of_big == pytest.approx(1024.0 * error, rel=0.3)


@pytest.mark.parametrize("name", ["quadric", "vtk-quadric", "angle-merge"])
def test_degrees_count_as_metres(name):
    grid = GRIDS["degrees"]
    error, of_metres = (
        rtin.vertical_error(made(one, name, max_vertices=300).mesh, one).rms
        for one in (grid, grid.in_metres())
    )
    assert of_metres == pytest.approx(error, rel=0.05)


def test_every_row_and_column_is_the_full_mesh():
    grid = GRIDS["square"]
    every = simplifiers.simplify(grid, "subsample", max_vertices=grid.n_samples)
    one, other = (
        {frozenset(map(tuple, mesh.vertices[corners].tolist())) for corners in mesh.triangles}
        for mesh in (every, simplifiers.full_mesh(grid))
    )
    assert one == other


def test_the_full_mesh_has_two_triangles_for_each_cell_without_voids():
    for grid in GRIDS.values():
        rows, cols = grid.shape
        mesh = simplifiers.full_mesh(grid)
        assert (mesh.n_vertices, mesh.n_triangles) == (rows * cols, 2 * (rows - 1) * (cols - 1))
    assert simplifiers.full_mesh(WITH_VOIDS).n_vertices <= WITH_VOIDS.n_samples


def test_rounding_to_32_bits_uncovers_no_border():
    grid = GRIDS["rotated"]
    mesh = simplifiers.full_mesh(grid)
    shift = 1e-5 * np.sin(np.arange(2 * mesh.n_vertices)).reshape(-1, 2)
    moved = np.column_stack([mesh.vertices[:, :2] + shift, mesh.vertices[:, 2]])
    off = rtin.TriangleMesh(moved, mesh.triangles)
    assert rtin.vertical_error(off, grid).n_uncovered > 0
    back = rtin.TriangleMesh(simplifiers._unrounded(grid, moved), mesh.triangles)
    assert rtin.vertical_error(back, grid).n_uncovered == 0


def test_triangles_of_decimate_pro_that_name_no_vertex_are_left_out():
    heights = np.random.default_rng(0).normal(size=(17, 17)).cumsum(axis=0).cumsum(axis=1)
    grid = rtin.Grid(heights, Affine(1e5, 0, 0, 0, -1e5, 0))  # flat enough to confuse VTK
    mesh = made(grid, "decimate-pro", max_vertices=4).mesh
    require_sound(mesh, grid)
    assert mesh.n_vertices <= 4


# --- angle merging ------------------------------------------------------------------------------


def whole(shape, seed=0):
    """A lattice whose heights make no two angles equal."""
    heights = np.random.default_rng(seed).normal(size=shape)
    mesh = simplifiers.full_mesh(rtin.Grid(heights))
    return mesh.vertices, mesh.triangles


def costs_of_merges(points, triangles):
    """Look at every edge by itself: those that may be merged, and the angle that decides."""
    beside = {}
    for number, corners in enumerate(triangles.tolist()):
        for a, b in itertools.pairwise([*corners, corners[0]]):
            beside.setdefault(frozenset((a, b)), []).append(number)

    def normal(number):
        a, b, c = points[triangles[number]]
        n = np.cross(b - a, c - a)
        return n / math.sqrt(n @ n)

    def angle(edge):
        one, other = (normal(number) for number in beside[edge])
        return math.atan2(np.linalg.norm(np.cross(one, other)), one @ other)

    def cost(edge):
        if len(beside[edge]) == 2:
            return angle(edge)
        (only,) = beside[edge]
        return min(angle(e) for e in beside if only in beside[e] and len(beside[e]) == 2)

    def sides(vertex):
        low, high = points.min(axis=0), points.max(axis=0)
        return {
            (axis, end[axis])
            for axis in (0, 1)
            for end in (low, high)
            if points[vertex, axis] == end[axis]
        }

    def allowed(edge):
        one, other = (sides(vertex) for vertex in edge)
        return (one <= other or other <= one) and min(len(one), len(other)) < 2

    return {edge: cost(edge) for edge in beside if allowed(edge)}


@pytest.mark.parametrize("shape", [(3, 3), (4, 7), (9, 6), (2, 8)])
def test_a_round_merges_the_smallest_angles_of_half_the_edges(shape):
    points, triangles = whole(shape)
    for _ in range(2):
        merges = _merging._choose(points, triangles, len(points))
        chosen = [frozenset(pair) for pair in merges.tolist()]
        costs = costs_of_merges(points, triangles)
        ranked = sorted(costs.values())
        largest = ranked[max(1, len(ranked) // 2) - 1] + 1e-12
        assert sum(map(len, chosen)) == len(frozenset().union(*chosen))
        assert [costs[edge] for edge in chosen] == sorted(costs[edge] for edge in chosen)
        assert all(costs[edge] <= largest for edge in chosen)
        for edge, cost in costs.items():  # who is left out stands behind one that was merged
            if cost < largest - 2e-12 and edge not in chosen:
                assert any(edge & other and costs[other] <= cost + 1e-12 for other in chosen)
        points = _merging._merged(points, merges)
        triangles = _merging._delaunay(points)


@pytest.mark.parametrize("n_vertices", [4, 5, 17, 40, 62])
def test_merging_leaves_so_many_vertices_a_straight_outline_and_a_right_mesh(n_vertices):
    for heights in (terrains.plateaus((9, 7)), rough((9, 7)), np.zeros((9, 7))):
        mesh = simplifiers.full_mesh(rtin.Grid(heights))
        points, triangles = _merging.merge_flat(mesh.vertices, mesh.triangles, n_vertices)
        merged = rtin.TriangleMesh.from_triangles(points, triangles)
        assert merged.n_vertices == n_vertices
        assert validity.complaints(merged) == []
        assert merged.signed_areas().sum() == pytest.approx(8 * 6, rel=1e-12)


def test_vertices_meet_in_the_middle_unless_a_side_holds_one():
    points, triangles = whole((6, 7))
    merges = _merging._choose(points, triangles, len(points))
    merged = {tuple(point) for point in _merging._merged(points, merges).tolist()}
    inside = lambda xy: 0.0 < xy[0] < 6.0 and -5.0 < xy[1] < 0.0  # noqa: E731
    held = 0
    for a, b in points[merges]:
        middle = 0.5 * (a + b)
        on_one_side = (a[0] == b[0] and a[0] in (0.0, 6.0)) or (
            a[1] == b[1] and a[1] in (0.0, -5.0)
        )
        is_corner = a[0] in (0.0, 6.0) and a[1] in (0.0, -5.0)
        if (inside(a) and inside(b)) or (on_one_side and not is_corner):
            assert tuple(middle) in merged
        else:
            held += 1
            assert tuple(a) in merged
            assert tuple(middle) not in merged
    assert 0 < held < len(merges)
    assert len(merged) == len(points) - len(merges)


def test_merging_keeps_a_plane():
    grid = rtin.Grid(terrains.tilted((17, 17)))
    mesh = made(grid, "angle-merge", max_vertices=30).mesh
    assert rtin.vertical_error(mesh, grid).max < 1e-9


def test_merging_thins_flat_parts_first():
    heights = np.zeros((33, 33))
    heights[:, 16:] = rough((33, 17))
    mesh = made(rtin.Grid(heights), "angle-merge", max_vertices=500).mesh
    assert (mesh.vertices[:, 0] < 15.0).sum() < 0.3 * mesh.n_vertices


# --- what they can't do -------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODULES)
def test_what_is_not_installed_says_which_package_to_install(name, monkeypatch):
    monkeypatch.setitem(sys.modules, MODULES[name], None)
    with pytest.raises(NotInstalled, match=f"pip install {SIMPLIFIERS[name].package}"):
        simplifiers.simplify(GRIDS["square"], name, max_vertices=100)


@pytest.mark.parametrize("name", ["martini", "delatin", "angle-merge"])
def test_those_that_know_no_voids_refuse_them(name):
    pytest.importorskip(MODULES[name])
    with pytest.raises(NotSuited, match="without a height"):
        simplifiers.simplify(WITH_VOIDS, name, max_vertices=100)


@pytest.mark.parametrize("shape", [(33, 17), (32, 32), (2, 2)])
def test_martini_refuses_what_fills_no_lattice(shape):
    pytest.importorskip("pymartini")
    with pytest.raises(NotSuited, match=f"got {shape[0]} × {shape[1]}"):
        simplifiers.simplify(rtin.Grid(rough(shape)), "martini", max_vertices=4)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("threshold", r"does not get below \d+ vertices on this grid, got max_vertices=5"),
        ("rtin", r"must be at least \d+ for this outline .* got 5"),
    ],
)
def test_too_few_vertices_are_refused_with_the_least_there_can_be(name, message):
    with pytest.raises(NotSuited, match=message):
        simplifiers.simplify(WITH_VOIDS, name, max_vertices=5)


def test_nothing_left_is_refused():
    heights = np.full((9, 9), np.nan)
    heights[3:6, 3:6] = rough((3, 3))
    with pytest.raises(NotSuited, match="leaves nothing of this grid, got max_vertices=4"):
        simplifiers.simplify(rtin.Grid(heights), "subsample", max_vertices=4)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "message"),
    [
        (["martin"], {"max_error": 1.0}, ValueError, "got 'martin'"),
        (["rtin"], {}, ValueError, "exactly one of max_error, max_vertices"),
        (["rtin"], {"max_error": 1.0, "max_vertices": 9}, ValueError, "exactly one"),
        (["quadric"], {"max_error": -1.0}, ValueError, "zero or more"),
        (["quadric"], {"max_error": "low"}, TypeError, "must be a number"),
        (["quadric"], {"max_vertices": 9.0}, TypeError, "whole number"),
        (["subsample"], {"max_vertices": True}, TypeError, "whole number"),
        (["angle-merge"], {"max_vertices": 3}, ValueError, "at least 4"),
    ],
)
def test_bad_arguments_are_refused(arguments, options, error, message):
    with pytest.raises(error, match=message):
        simplifiers.simplify(GRIDS["square"], *arguments, **options)


def test_heights_alone_are_no_grid():
    with pytest.raises(TypeError, match="a Grid is wanted"):
        simplifiers.simplify(np.zeros((3, 3)), "rtin", max_error=1.0)


# --- figures ------------------------------------------------------------------------------------


def test_figures_are_those_of_the_mesh(tmp_path):
    grid = GRIDS["degrees"]
    found = simplifiers.simplified(grid, "rtin", max_vertices=200)
    figures = simplifiers.compared(grid, "rtin", found)
    error = rtin.vertical_error(found.mesh, grid)
    rtin.write_mesh(found.mesh, tmp_path / "mesh.glb")
    assert figures.n_bytes == (tmp_path / "mesh.glb").stat().st_size
    assert (figures.max, figures.rms, figures.mean) == (error.max, error.rms, error.mean)
    assert (figures.n_vertices, figures.n_triangles) == (
        found.mesh.n_vertices,
        found.mesh.n_triangles,
    )
    assert (figures.n_uncovered, figures.faults) == (0, ())


def test_figures_tell_what_is_wrong_with_a_mesh():
    grid = GRIDS["square"]
    mesh = simplifiers.full_mesh(grid)
    torn = rtin.TriangleMesh(mesh.vertices, np.delete(mesh.triangles, [0, 1, 2], axis=0))
    figures = simplifiers.compared(grid, "x", simplifiers.Simplified(torn, "step", 1, 0.0))
    assert figures.n_uncovered > 0
    twice = rtin.TriangleMesh(mesh.vertices, np.vstack([mesh.triangles, mesh.triangles[:1]]))
    figures = simplifiers.compared(grid, "x", simplifiers.Simplified(twice, "step", 1, 0.0))
    assert any("are the same" in fault for fault in figures.faults)
