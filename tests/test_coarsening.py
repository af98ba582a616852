"""`coarsen` against its naive twin, all small meshes, the mathematics' laws, and pymartini."""

import hashlib
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive
import rtin
import terrains
from rtin import validity


def grid_of(heights, **options):
    return rtin.Grid(np.asarray(heights, dtype=np.float32), **options)


def set_of(keep):
    return set() if keep is None else {tuple(place) for place in np.argwhere(keep)}


def vertex_set(mesh, grid):
    return set(naive.places(mesh, grid))


def assert_same(mesh, grid, triangles):
    assert naive.triangles_of(mesh, grid) == naive.visible(grid.heights, triangles)
    assert vertex_set(mesh, grid) == naive.corners_of(naive.visible(grid.heights, triangles))


def valid_keep(grid, mask):
    """What can be kept, as places: marked samples that have a height."""
    return set_of(mask & ~np.isnan(grid.heights))


# --- against the naive twin ---------------------------------------------------------------------


@pytest.mark.parametrize("holes", terrains.HOLES)
@pytest.mark.parametrize("shape", terrains.SHAPES, ids=str)
def test_is_the_least_mesh_on_every_shape_and_hole(shape, holes):
    for number, terrain in enumerate(terrains.GALLERY.values()):
        heights = terrains.pierced(terrain(shape), terrains.HOLES[holes](shape))
        if not terrains.has_a_triangle(heights):
            continue
        grid = grid_of(heights)
        tolerance = [0.0, 0.5, 3.0, 20.0][number % 4]
        mesh = rtin.coarsen(grid, max_error=tolerance)
        assert_same(mesh, grid, naive.least(grid.heights, tolerance)[1])
        validity.check(mesh)


@given(terrains.rasters(), terrains.tolerances)
def test_is_the_least_mesh_on_any_terrain(heights, tolerance):
    grid = grid_of(heights)
    mesh = rtin.coarsen(grid, max_error=tolerance)
    assert_same(mesh, grid, naive.least(grid.heights, tolerance)[1])
    validity.check(mesh)


@given(terrains.rasters(), st.data())
def test_is_the_least_mesh_for_a_map_of_tolerances(heights, data):
    grid = grid_of(heights)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    choices = data.draw(st.sampled_from([[0.0, np.inf], [0.5, 2.0, 7.0], [1.0, 1.0, 1.0, 0.0]]))
    tolerance = rng.choice(choices, grid.shape)
    mesh = rtin.coarsen(grid, max_error=tolerance)
    assert_same(mesh, grid, naive.least(grid.heights, tolerance)[1])


@given(terrains.rasters(), terrains.tolerances, st.data())
def test_is_the_least_mesh_that_keeps_what_must_be_kept(heights, tolerance, data):
    grid = grid_of(heights)
    keep = data.draw(terrains.masks(grid.shape))
    mesh = rtin.coarsen(grid, max_error=tolerance, keep=keep)
    wanted = valid_keep(grid, keep)
    assert_same(mesh, grid, naive.least(grid.heights, tolerance, wanted)[1])
    covered = naive.corners_of(naive.finest(grid.heights))
    assert wanted & covered <= vertex_set(mesh, grid)


@given(terrains.rasters(), terrains.tolerances, st.data())
def test_threshold_is_the_papers_algorithm(heights, threshold, data):
    grid = grid_of(heights)
    keep = data.draw(st.none() | terrains.masks(grid.shape))
    mesh = rtin.coarsen(grid, threshold=threshold, keep=keep)
    wanted = set() if keep is None else valid_keep(grid, keep)
    assert_same(mesh, grid, naive.thresholded(grid.heights, threshold, wanted)[1])
    validity.check(mesh)


@given(terrains.rasters(), st.sampled_from([0.0, 0.03, 0.3, 1.0]), st.data())
def test_removable_is_the_papers_matrix(heights, share, data):
    grid = grid_of(heights)
    unmarked = data.draw(terrains.masks(grid.shape, share))
    keep = data.draw(st.none() | terrains.masks(grid.shape))
    mesh = rtin.coarsen(grid, removable=~unmarked, keep=keep)
    wanted = set() if keep is None else valid_keep(grid, keep)
    assert_same(mesh, grid, naive.with_outline(grid.heights, set_of(unmarked), wanted)[1])


@pytest.mark.parametrize("size", [1, 2, 4, 8, 16])
def test_the_papers_steps_3_and_4_give_the_closure(size):
    rng = np.random.default_rng(size)
    places = list(np.ndindex(size + 1, size + 1))
    for share in (0.01, 0.05, 0.3):
        unmarked = {place for place in places if rng.random() < share}
        assert naive.rtin_coarsening(unmarked, size)[0] == closure(unmarked, size)


def closure(places, size):
    kept = places | naive.corners_of_lattice(size)
    return kept.union(*(naive.ancestors(place, size) for place in places))


def with_only(places, shape):
    """Matrix C with everything marked for removal but some places."""
    removable = np.ones(shape, bool)
    removable[tuple(np.transpose(list(places)))] = False
    return removable


@pytest.mark.parametrize("size", [1, 2, 4, 8, 16])
def test_every_vertex_keeps_its_ancestors_and_nothing_else(size):
    grid = grid_of(np.zeros((size + 1, size + 1)))
    for place in np.ndindex(grid.shape):
        expected = closure({place}, size)
        for options in (
            {"removable": with_only([place], grid.shape)},
            {"max_error": 0, "keep": ~with_only([place], grid.shape)},
            {"threshold": 1, "keep": ~with_only([place], grid.shape)},
        ):
            assert vertex_set(rtin.coarsen(grid, **options), grid) == expected


@pytest.mark.parametrize("size", [16, 32, 64])
def test_some_vertices_keep_their_ancestors_and_nothing_else(size):
    grid = grid_of(np.zeros((size + 1, size + 1)))
    rng = np.random.default_rng(size)
    for n_places in (2, 5, 20):
        for _ in range(20):
            places = {tuple(place) for place in rng.integers(0, size + 1, (n_places, 2)).tolist()}
            mesh = rtin.coarsen(grid, removable=with_only(places, grid.shape))
            assert vertex_set(mesh, grid) == closure(places, size)


# --- against all meshes of a small lattice ------------------------------------------------------


class AllMeshes:
    """Every conforming mesh of a lattice as a row of booleans, over triangles and over vertices."""

    def __init__(self, size):
        self.triangles = naive.all_triangles(size)
        self.vertices = list(np.ndindex(size + 1, size + 1))
        meshes = naive.conforming_meshes(size)
        corners = [naive.corners_of(mesh) for mesh in meshes]
        self.has_triangle = np.array([[t in mesh for t in self.triangles] for mesh in meshes])
        self.has_vertex = np.array([[v in kept for v in self.vertices] for kept in corners])


@pytest.fixture(scope="module", params=[1, 2, 4])
def all_meshes(request):
    return AllMeshes(request.param)


def test_is_least_among_all_meshes_within_the_tolerance(all_meshes):
    size = int(len(all_meshes.vertices) ** 0.5) - 1
    rng = np.random.default_rng(size)
    for number, tolerance in product(range(40), (0.0, 0.5, 1.0, 2.0)):
        heights = rng.integers(0, 2 + number // 8, (size + 1, size + 1)).astype(np.float32)
        grid = rtin.Grid(heights)
        exact = naive.exact_heights(heights)
        bad = [not naive.is_good(t, exact, tolerance) for t in all_meshes.triangles]
        within = ~(all_meshes.has_triangle & bad).any(axis=1)
        kept = vertex_set(rtin.coarsen(grid, max_error=tolerance), grid)
        ours = np.array([vertex in kept for vertex in all_meshes.vertices])
        assert (all_meshes.has_vertex[within] == ours).all(axis=1).any()
        assert (all_meshes.has_vertex[within] >= ours).all()


# --- the mathematics' laws ----------------------------------------------------------------------

REAL = {
    "jacksboro": lambda: rtin.Grid(rtin.samples.jacksboro_fault().heights[60:189, 90:219]),
    "topobathy": lambda: rtin.Grid(rtin.samples.topobathy().heights[10:75, 30:95]),
}


def is_within(triangle, heights, tolerance):
    """Whether all samples of a triangle of the lattice lie within the tolerance of its plane."""
    apex, a, b = triangle
    row, col = np.mgrid[
        min(p[0] for p in triangle) : max(p[0] for p in triangle) + 1,
        min(p[1] for p in triangle) : max(p[1] for p in triangle) + 1,
    ]
    area = naive.cross(apex, a, b)
    of_a = ((row - apex[0]) * (b[1] - apex[1]) - (col - apex[1]) * (b[0] - apex[0])) / area
    of_b = ((a[0] - apex[0]) * (col - apex[1]) - (a[1] - apex[1]) * (row - apex[0])) / area
    of_apex = 1.0 - of_a - of_b
    plane = of_apex * heights[apex] + of_a * heights[a] + of_b * heights[b]
    inside = (of_a >= 0) & (of_b >= 0) & (of_apex >= 0)
    return bool((abs(plane - heights[row, col])[inside] <= tolerance).all())


@pytest.mark.parametrize("name", REAL)
@pytest.mark.parametrize("tolerance", [25.0, 80.0])
def test_no_kept_vertex_can_be_removed_with_its_descendants(name, tolerance):
    grid = REAL[name]()
    heights = grid.heights.astype(np.float64)
    bisected = naive.bisections(grid.shape[0] - 1)
    children = {}
    for vertex, triangles in bisected.items():
        for apex, _, _ in triangles:
            children.setdefault(apex, []).append(vertex)
    kept = vertex_set(rtin.coarsen(grid, max_error=tolerance), grid)
    good = {}

    def stays_good(triangle):
        if triangle not in good:
            good[triangle] = is_within(triangle, heights, tolerance)
        return good[triangle]

    def with_descendants(vertex):
        removed, stack = set(), [vertex]
        while stack:
            removed.add(vertex := stack.pop())
            stack += [v for v in children.get(vertex, []) if v in kept and v not in removed]
        return removed

    assert 0.02 < len(kept) / heights.size < 0.8
    for vertex in kept & bisected.keys():
        removed = with_descendants(vertex)
        merged = (t for v in removed for t in bisected[v] if t[0] in kept - removed)
        assert not all(stays_good(triangle) for triangle in merged)


@given(terrains.rasters(), terrains.tolerances, terrains.tolerances)
def test_a_smaller_tolerance_keeps_a_superset(heights, one, other):
    grid = grid_of(heights)
    finer, coarser = sorted([one, other])
    for criterion in ("max_error", "threshold"):
        kept = [vertex_set(rtin.coarsen(grid, **{criterion: t}), grid) for t in (finer, coarser)]
        assert kept[0] >= kept[1]


@given(terrains.rasters(holes=False), st.data())
def test_closure_is_idempotent_and_monotone(heights, data):
    grid = grid_of(heights)
    few = data.draw(terrains.masks(grid.shape, 0.05))
    more = few | data.draw(terrains.masks(grid.shape, 0.05))
    few_kept, more_kept = (
        vertex_set(rtin.coarsen(grid, removable=~mask), grid) for mask in (few, more)
    )
    assert set_of(few) <= few_kept <= more_kept
    again = np.ones(grid.shape, bool)
    again[tuple(np.transpose(list(few_kept)))] = False
    assert vertex_set(rtin.coarsen(grid, removable=again), grid) == few_kept


@given(terrains.rasters(), terrains.tolerances, st.integers(-9, 9), st.integers(-9, 9))
def test_ignores_a_tilt_of_the_terrain(heights, tolerance, row_slope, col_slope):
    row, col = np.indices(heights.shape)
    grids = grid_of(heights), grid_of(heights + row_slope * row + col_slope * col + 100)
    for criterion in ("max_error", "threshold"):
        level, tilted = (rtin.coarsen(grid, **{criterion: tolerance}) for grid in grids)
        np.testing.assert_array_equal(level.triangles, tilted.triangles)
        np.testing.assert_array_equal(level.vertices[:, :2], tilted.vertices[:, :2])


@given(terrains.rasters(), terrains.tolerances)
def test_transposes_with_the_terrain(heights, tolerance):
    grid, transposed = grid_of(heights), grid_of(heights.T)
    for criterion in ("max_error", "threshold"):
        mesh, other = (rtin.coarsen(g, **{criterion: tolerance}) for g in (grid, transposed))
        assert naive.triangles_of(mesh, grid) == {
            frozenset((row, col) for col, row in triangle)
            for triangle in naive.triangles_of(other, transposed)
        }


@given(st.sampled_from([3, 5, 9, 17]), st.sampled_from(list(terrains.GALLERY)), st.booleans())
def test_turns_half_round_with_a_terrain_that_fills_its_lattice(side, terrain, pierced):
    heights = terrains.GALLERY[terrain]((side, side))
    if pierced:
        heights = terrains.pierced(heights, terrains.scattered(heights.shape))
    grid, turned = grid_of(heights), grid_of(heights[::-1, ::-1])
    mesh, other = (rtin.coarsen(g, max_error=2.0) for g in (grid, turned))
    assert naive.triangles_of(mesh, grid) == {
        frozenset((side - 1 - row, side - 1 - col) for row, col in triangle)
        for triangle in naive.triangles_of(other, turned)
    }


def test_a_mirrored_terrain_has_another_mesh():
    row, col = np.indices((9, 9))
    heights = abs(row - col)  # a valley along the first diagonal, which begins at row 0, column 0
    grid, mirrored = grid_of(heights), grid_of(heights[:, ::-1])
    assert rtin.coarsen(grid, max_error=0).n_triangles == 2
    assert rtin.coarsen(mirrored, max_error=0).n_triangles == 4


# --- the mesh as a whole ------------------------------------------------------------------------


def unit_triangles(triangle):
    """The finest triangles inside one of the mesh, given with its apex first."""
    if naive.is_unit(triangle):
        return [frozenset(triangle)]
    return [unit for half in naive.halves(triangle) for unit in unit_triangles(half)]


def assert_covers_exactly_what_has_heights(mesh, grid):
    at = naive.places(mesh, grid)
    units = [
        unit for a, b, apex in mesh.triangles for unit in unit_triangles((at[apex], at[a], at[b]))
    ]
    assert len(units) == len(set(units))
    assert set(units) == naive.finest(grid.heights)


@given(terrains.rasters(), terrains.tolerances)
def test_covers_exactly_the_finest_triangles_with_three_heights(heights, tolerance):
    grid = grid_of(heights)
    for criterion in ("max_error", "threshold"):
        mesh = rtin.coarsen(grid, **{criterion: tolerance})
        assert_covers_exactly_what_has_heights(mesh, grid)


@pytest.mark.parametrize("transform", terrains.TRANSFORMS)
@pytest.mark.parametrize("holes", terrains.HOLES)
def test_is_a_right_mesh_under_every_transform(transform, holes):
    shape = (17, 23)
    heights = terrains.pierced(terrains.waves(shape), terrains.HOLES[holes](shape))
    grid = grid_of(heights, transform=terrains.TRANSFORMS[transform])
    mesh = rtin.coarsen(grid, max_error=4.0)
    validity.check(mesh)
    assert (mesh.signed_areas() > 0.0).all()
    at = np.array(naive.places(mesh, grid))
    assert (np.diff(at @ [shape[1], 1]) > 0).all()  # row-major
    np.testing.assert_array_equal(mesh.vertices[:, 2], grid.heights[tuple(at.T)])
    x, y = grid.transform @ (at[:, 1].astype(float), at[:, 0].astype(float))
    np.testing.assert_allclose(mesh.vertices[:, :2], np.column_stack([x, y]), rtol=1e-15)
    a, b, apex = (at[corner] for corner in mesh.triangles.T)
    legs = a - apex, b - apex
    assert ((legs[0] * legs[1]).sum(axis=1) == 0).all()
    assert ((legs[0] ** 2).sum(axis=1) == (legs[1] ** 2).sum(axis=1)).all()
    cells = mesh.signed_areas().sum() / abs(grid.transform.determinant)
    assert cells == pytest.approx(len(naive.finest(grid.heights)) / 2, rel=1e-9)


@pytest.mark.parametrize("terrain", terrains.GALLERY)
@pytest.mark.parametrize("shape", [(17, 17), (33, 33), (17, 23), (40, 9)], ids=str)
def test_without_holes_is_a_disc_bounded_by_the_raster(terrain, shape):
    grid = grid_of(terrains.GALLERY[terrain](shape))
    mesh = rtin.coarsen(grid, max_error=3.0)
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    assert mesh.n_vertices - len(edges) + mesh.n_triangles == 1
    at = np.array(naive.places(mesh, grid))
    for a, b in edges[counts == 1]:
        on_a_border = [
            (at[[a, b], axis] == end).all() for axis in (0, 1) for end in (0, shape[axis] - 1)
        ]
        assert any(on_a_border)


def test_carries_the_crs():
    assert rtin.coarsen(grid_of([[1, 2], [3, 4]], crs="EPSG:2056"), max_error=1).crs == "EPSG:2056"


def families(grid):
    keep = np.zeros(grid.shape, bool)
    keep[5::17, 3::13] = True
    tolerance = np.where(np.indices(grid.shape)[1] < 60, 0.2, np.inf)
    yield rtin.coarsen(grid, max_error=3.0)
    yield rtin.coarsen(grid, max_error=tolerance, keep=keep)
    yield rtin.coarsen(grid, threshold=3.0, keep=keep)
    yield rtin.coarsen(grid, removable=~keep)
    yield rtin.coarsen(grid, max_vertices=45_000)
    yield from rtin.coarsen_levels(grid, [1.0, 8.0])


def same_bytes(meshes, others):
    return all(
        mesh.vertices.tobytes() == other.vertices.tobytes()
        and mesh.triangles.tobytes() == other.triangles.tobytes()
        for mesh, other in zip(meshes, others, strict=True)
    )


LARGE = {"square": (257, 257), "oblong": (150, 310), "tall": (333, 90)}


@pytest.mark.parametrize("holes", ["none", "pond", "scattered"])
@pytest.mark.parametrize("shape", LARGE)
def test_number_of_threads_changes_no_byte(monkeypatch, shape, holes):
    shape = LARGE[shape]
    heights = terrains.waves(shape) + terrains.noise(shape) / 16
    grid = rtin.Grid(terrains.pierced(heights, terrains.HOLES[holes](shape)))
    meshes = {}
    for n_threads in ("1", "2", "5"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        meshes[n_threads] = list(families(grid))
    assert same_bytes(meshes["1"], meshes["2"])
    assert same_bytes(meshes["1"], meshes["5"])


@given(terrains.rasters(largest=20), terrains.tolerances, st.sampled_from([2, 3, 5]))
def test_bands_of_rows_change_no_byte(heights, tolerance, rows_in_a_band):
    from rtin import _parallel, coarsening

    grid = grid_of(heights)
    whole = [rtin.coarsen(grid, **{name: tolerance}) for name in ("max_error", "threshold")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_parallel, "_FEWEST_ROWS", rows_in_a_band)
        patch.setattr(coarsening, "_COARSE_PARTS", 1)
        cut = [rtin.coarsen(grid, **{name: tolerance}) for name in ("max_error", "threshold")]
    assert same_bytes(whole, cut)


# --- ties, and heights of every kind ------------------------------------------------------------


@given(terrains.rasters())
def test_zero_is_lossless(heights):
    grid = grid_of(heights)
    mesh = rtin.coarsen(grid, max_error=0)
    error = rtin.vertical_error(mesh, grid)
    assert error.max == 0.0
    covered = len(naive.corners_of(naive.finest(grid.heights)))
    assert error.n_samples == covered


def bump(height):
    return [[0, 0, 0], [0, height, 0], [0, 0, 0]]


def test_an_error_equal_to_the_tolerance_is_accepted():
    assert rtin.coarsen(grid_of(bump(1)), max_error=1).n_triangles == 2
    assert rtin.coarsen(grid_of(bump(1)), max_error=np.nextafter(1, 0)).n_triangles == 4


def test_an_eq_1_error_equal_to_the_threshold_is_kept():
    assert rtin.coarsen(grid_of(bump(1)), threshold=1).n_triangles == 4
    assert rtin.coarsen(grid_of(bump(1)), threshold=np.nextafter(1, 2)).n_triangles == 2


def test_a_threshold_of_zero_removes_nothing():
    assert rtin.coarsen(grid_of(np.zeros((9, 9))), threshold=0).n_vertices == 81


def test_an_infinite_tolerance_leaves_the_outline():
    noise = terrains.noise((33, 33))
    assert rtin.coarsen(grid_of(noise), max_error=np.inf).n_triangles == 2
    assert rtin.coarsen(grid_of(noise), threshold=np.inf).n_triangles == 2


def exact_error(mesh, grid):
    """Largest error over all triangles in exact arithmetic."""
    at, exact = naive.places(mesh, grid), naive.exact_heights(grid.heights)
    return max(naive.worst_error((at[apex], at[a], at[b]), exact) for a, b, apex in mesh.triangles)


@pytest.mark.parametrize("seed", range(5))
def test_keeps_its_promise_on_heights_that_float32_cannot_hold(seed):
    relief = np.random.default_rng(seed).random((17, 17)) * 4e-3
    grid = rtin.Grid(1e8 + relief)
    assert grid.heights.dtype == np.float64
    mesh = rtin.coarsen(grid, max_error=1e-3)
    assert 4 < mesh.n_vertices < 289
    rounding = np.spacing(1e8)
    assert rtin.vertical_error(mesh, grid).max <= 1e-3 + rounding
    assert exact_error(mesh, grid) <= 1e-3 + rounding
    np.testing.assert_array_equal(np.isin(mesh.vertices[:, 2], grid.heights), True)


@pytest.mark.parametrize(
    "dtype", ["i1", "u1", "i2", ">i2", "u2", "i4", "i8", "u8", "f2", ">f4", "f8"]
)
def test_the_type_of_the_heights_changes_nothing(dtype):
    heights = np.abs(terrains.staircase((17, 13)))
    expected = rtin.coarsen(rtin.Grid(heights), max_error=2)
    mesh = rtin.coarsen(rtin.Grid(heights.astype(dtype)), max_error=2)
    assert same_bytes([expected], [mesh])


def test_large_whole_numbers_keep_every_digit():
    heights = 2**40 + terrains.staircase((17, 17)).astype(np.int64)
    mesh = rtin.coarsen(rtin.Grid(heights), max_error=0)
    level = rtin.coarsen(rtin.Grid(heights - 2**40), max_error=0)
    np.testing.assert_array_equal(mesh.triangles, level.triangles)
    np.testing.assert_array_equal(mesh.vertices[:, 2] - 2**40, level.vertices[:, 2])


def test_masked_samples_are_void():
    heights = terrains.waves((17, 17))
    masked = np.ma.masked_array(heights, terrains.pond(heights.shape))
    with_nan = terrains.pierced(heights, terrains.pond(heights.shape))
    assert same_bytes(
        [rtin.coarsen(rtin.Grid(masked), max_error=2)],
        [rtin.coarsen(rtin.Grid(with_nan), max_error=2)],
    )


def test_a_map_of_tolerances_is_kept_where_it_is_finite():
    grid = rtin.samples.topobathy()
    tolerance = np.full(grid.shape, np.inf)
    tolerance[20:60, 30:80] = 25.0
    mesh = rtin.coarsen(grid, max_error=tolerance)
    field = abs(rtin.vertical_error(mesh, grid).field)
    assert (field <= tolerance).all()
    assert field.max() > 25.0
    everywhere = rtin.coarsen(grid, max_error=25.0)
    assert mesh.n_vertices < everywhere.n_vertices


def test_a_constant_map_of_tolerances_is_that_tolerance():
    grid = REAL["jacksboro"]()
    assert same_bytes(
        [rtin.coarsen(grid, max_error=20)],
        [rtin.coarsen(grid, max_error=np.full(grid.shape, 20))],
    )


@pytest.mark.parametrize("tolerance", [0.5, 7.0, 100.0])
def test_the_promise_holds_on_real_terrain(tolerance):
    for grid in (rtin.samples.jacksboro_fault(), rtin.samples.topobathy()):
        error = rtin.vertical_error(rtin.coarsen(grid, max_error=tolerance), grid)
        assert error.max <= tolerance
        assert error.n_uncovered == 0


@pytest.mark.parametrize("shape", [(33, 33), (20, 33), (9, 17)], ids=str)
def test_voids_are_not_split(shape):
    from rtin.coarsening import _least_mesh

    grid = grid_of(terrains.pierced(terrains.waves(shape), terrains.pond(shape)))
    kept = _least_mesh(grid, (2.0, None), None)
    assert set_of(kept) == naive.least(grid.heights, 2.0)[0]


# --- keep ---------------------------------------------------------------------------------------


def test_keeping_the_corners_of_the_lattice_costs_nothing():
    keep = np.zeros((17, 17), bool)
    keep[::16, ::16] = True
    grid = grid_of(np.zeros((17, 17)))
    assert rtin.coarsen(grid, max_error=1, keep=keep).n_triangles == 2


def test_keeping_a_void_is_ignored():
    heights = terrains.pierced(np.zeros((9, 9)), terrains.pond((9, 9)))
    grid = grid_of(heights)
    plain = rtin.coarsen(grid, max_error=1)
    assert same_bytes([plain], [rtin.coarsen(grid, max_error=1, keep=np.isnan(heights))])


def test_keeping_everything_keeps_every_sample():
    grid = grid_of(np.zeros((6, 11)))
    assert rtin.coarsen(grid, max_error=9, keep=np.ones((6, 11), bool)).n_vertices == 66


# --- several levels -----------------------------------------------------------------------------


@given(terrains.rasters(), st.lists(terrains.tolerances, min_size=1, max_size=4), st.data())
def test_levels_equal_separate_calls(heights, tolerances, data):
    grid = grid_of(heights)
    keep = data.draw(st.none() | terrains.masks(grid.shape))
    levels = rtin.coarsening.coarsen_levels(grid, tolerances, keep=keep)
    assert same_bytes(levels, [rtin.coarsen(grid, max_error=t, keep=keep) for t in tolerances])


def test_levels_of_real_terrain_equal_separate_calls():
    grid = rtin.samples.jacksboro_fault()
    tolerances = [5, 80, 20.0, 5, np.inf, 0]
    levels = rtin.coarsening.coarsen_levels(grid, tolerances)
    assert same_bytes(levels, [rtin.coarsen(grid, max_error=t) for t in tolerances])


# --- pymartini ----------------------------------------------------------------------------------


def martini_places(heights, threshold):
    """Places that pymartini keeps; its vertices are (x, y), x being the column."""
    pymartini = pytest.importorskip("pymartini")
    tile = pymartini.Martini(len(heights)).create_tile(np.ascontiguousarray(heights, np.float32))
    vertices, _ = tile.get_mesh(threshold)
    return {(int(y), int(x)) for x, y in np.reshape(vertices, (-1, 2))}


def between(errors, share):
    """A threshold that is no vertex's error, with about this share of them below."""
    errors = np.unique(errors[np.isfinite(errors)])
    at = min(int(share * len(errors)), len(errors) - 2)
    return float((errors[at] + errors[at + 1]) / 2)


def martini_terrains():
    jacksboro = rtin.samples.jacksboro_fault().heights
    topobathy = rtin.samples.topobathy().heights
    yield pytest.param(jacksboro[:257, :257], id="jacksboro")
    yield pytest.param(jacksboro[80:209, 200:329], id="part of jacksboro")
    yield pytest.param(topobathy[:65, :65], id="topobathy")
    for side in (3, 5, 9, 33):
        noise = terrains.noise((side, side), seed=side).astype(np.float32)
        yield pytest.param(noise, id=f"noise {side}")
    yield pytest.param(terrains.waves((65, 65)).astype(np.float32), id="waves")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("heights", list(martini_terrains()))
def test_threshold_keeps_the_vertices_that_martini_keeps(heights, share):
    grid = rtin.Grid(heights)
    threshold = between(rtin.vertex_errors(grid), share)
    kept = vertex_set(rtin.coarsen(grid, threshold=threshold), grid)
    assert kept == martini_places(heights, threshold)


# --- counts -------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", range(8))
def test_flat_terrain_needs_two_triangles_and_noise_all_of_them(k):
    side = 2**k + 1
    noise = np.random.default_rng(k).random((side, side))
    assert rtin.coarsen(grid_of(np.ones((side, side))), max_error=0).n_triangles == 2
    mesh = rtin.coarsen(rtin.Grid(noise), max_error=0)
    assert (mesh.n_triangles, mesh.n_vertices) == (2 * 4**k, side**2)


@pytest.mark.parametrize("k", range(1, 8))
def test_keeping_one_corner_sample_refines_towards_it(k):
    side = 2**k + 1
    keep = np.zeros((side, side), bool)
    keep[0, 1] = True
    mesh = rtin.coarsen(grid_of(np.zeros((side, side))), max_error=0, keep=keep)
    assert (mesh.n_vertices, mesh.n_triangles) == (3 * k + 3, 4 * k + 1)


def test_the_golden_mesh_stays_the_same():
    grid = rtin.samples.jacksboro_fault()
    mesh = rtin.coarsen(grid, max_error=50)
    at = np.array(naive.places(mesh, grid), "<i4")
    digest = hashlib.sha256(at.tobytes() + mesh.triangles.astype("<i4").tobytes()).hexdigest()
    assert (mesh.n_vertices, mesh.n_triangles, digest[:16]) == (7250, 13638, "d2407005d29251c1")


# --- the door -----------------------------------------------------------------------------------

GRID = rtin.Grid(np.zeros((5, 4)))
WRONG = {
    "negative": ({"max_error": -5}, ValueError, "zero or more, .* got -5"),
    "NaN": ({"max_error": float("nan")}, ValueError, "zero or more, .* got nan"),
    "string": ({"max_error": "5"}, TypeError, "must be a number, got '5'"),
    "boolean": ({"max_error": True}, TypeError, "must be a number, got True"),
    "list": ({"threshold": [1.0]}, TypeError, "must be a number"),
    "complex": ({"max_error": 1j}, TypeError, "must be a number, got 1j"),
    "map shape": ({"max_error": np.ones((4, 5))}, ValueError, r"\(5, 4\), got .* \(4, 5\)"),
    "map type": ({"max_error": np.full((5, 4), "a")}, TypeError, "must hold numbers, got"),
    "map of booleans": ({"max_error": np.ones((5, 4), bool)}, TypeError, "must hold numbers, got"),
    "map value": ({"max_error": -np.ones((5, 4))}, ValueError, "-1.0 at row 0, column 0"),
    "map NaN": ({"max_error": np.full((5, 4), np.nan)}, ValueError, "nan at row 0, column 0"),
    "two options": ({"max_error": 1, "threshold": 1}, ValueError, "got max_error, threshold"),
    "no option": ({}, ValueError, "exactly one of max_error, .* got none"),
    "keep alone": ({"keep": np.ones((5, 4), bool)}, ValueError, "got none"),
    "keep type": ({"max_error": 1, "keep": np.ones((5, 4))}, TypeError, "keep .* booleans, got"),
    "keep shape": ({"max_error": 1, "keep": np.ones(4, bool)}, ValueError, r"keep .* got \(4,\)"),
    "matrix type": ({"removable": np.ones((5, 4), int)}, TypeError, "removable .* booleans, got"),
    "matrix shape": ({"removable": np.ones((4, 4), bool)}, ValueError, r"removable .* got \(4, 4"),
    "negative threshold": ({"threshold": -1.0}, ValueError, "threshold .* zero or more, .* got -1"),
    "fraction": ({"max_vertices": 10.0}, TypeError, "max_vertices .* whole number, got 10.0"),
    "boolean count": (
        {"max_triangles": True},
        TypeError,
        "max_triangles .* whole .* got True",
    ),
    "heights for a word": (
        {"max_error": 1, "heights": np.zeros(4)},
        ValueError,
        r"heights must be 'sampled' or 'fitted', got array\(",
    ),
    "list for a word": (
        {"max_error": 1, "diagonals": np.array(["best", "best"])},
        ValueError,
        r"diagonals must be 'lattice' or 'best', got array\(",
    ),
    "small budget": (
        {"max_triangles": 1},
        ValueError,
        r"must be at least \d+ .* got 1",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_says_in_one_line_what_was_wanted_and_what_came(wrong):
    options, error, message = WRONG[wrong]
    with pytest.raises(error, match=message) as raised:
        rtin.coarsen(GRID, **options)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("value", [np.zeros((3, 3)), None, "dem.tif"], ids=str)
def test_wants_a_grid(value):
    with pytest.raises(TypeError, match=r"a Grid is wanted, got \w+"):
        rtin.coarsen(value, max_error=1)
    with pytest.raises(TypeError, match=r"a Grid is wanted, got \w+"):
        rtin.coarsening.coarsen_levels(value, [1])


@pytest.mark.parametrize(
    ("tolerances", "error", "message"),
    [
        ([], ValueError, "at least one tolerance"),
        ([1, -1], ValueError, "max_errors .* got -1"),
        (["a"], TypeError, "max_errors .* got 'a'"),
        ([np.nan], ValueError, "got nan"),
    ],
)
def test_levels_want_tolerances(tolerances, error, message):
    with pytest.raises(error, match=message):
        rtin.coarsening.coarsen_levels(GRID, tolerances)


def test_says_that_nothing_is_left_where_no_triangle_has_three_heights():
    heights = np.full((5, 5), np.nan)
    heights[::2, ::2] = 1.0
    for options in ({"max_error": 1}, {"threshold": 1}, {"removable": np.ones((5, 5), bool)}):
        with pytest.raises(ValueError, match="no triangle to keep"):
            rtin.coarsen(rtin.Grid(heights), **options)


def test_says_how_large_a_lattice_would_have_been():
    grid = rtin.Grid(np.zeros((2, 2**22 + 2), np.float32))
    with pytest.raises(MemoryError, match=r"8388609 × 8388609 samples needs \d+\.\d GiB"):
        rtin.coarsen(grid, max_error=1)


@pytest.mark.parametrize("value", ["0", "-1", "two", "1.5"])
def test_wants_a_whole_number_of_threads(monkeypatch, value):
    monkeypatch.setenv("RTIN_NUM_THREADS", value)
    with pytest.raises(ValueError, match=f"RTIN_NUM_THREADS .* got '{value}'"):
        rtin.coarsen(GRID, max_error=1)


def test_a_mesh_too_large_for_its_numbers_is_refused(monkeypatch):
    monkeypatch.setattr("rtin.coarsening._MOST_NUMBERS", 10)
    with pytest.raises(ValueError, match="more than 10; allow a larger error"):
        rtin.coarsen(rtin.Grid(np.random.default_rng(0).random((9, 9))), max_error=0)
