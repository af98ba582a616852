"""`diagonals="best"` against its naive twin, all meshes of a small lattice, and its laws."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import naive
import rtin
import terrains
from rtin import validity


def grid_of(heights, **options):
    return rtin.Grid(np.asarray(heights, dtype=np.float32), **options)


def set_of(mask):
    return {tuple(place) for place in np.argwhere(mask).tolist()}


def best(grid, **options):
    return rtin.coarsen(grid, diagonals="best", **options)


def vertex_set(mesh, grid):
    return set(naive.places(mesh, grid))


def assert_same(mesh, grid, triangles):
    assert naive.triangles_of(mesh, grid) == naive.visible(grid.heights, triangles)
    validity.check(mesh)


def same_bytes(mesh, other):
    return (
        mesh.vertices.tobytes() == other.vertices.tobytes()
        and mesh.triangles.tobytes() == other.triangles.tobytes()
    )


def valley_off_the_lattices_diagonal(side):
    row, col = np.indices((side, side))
    return 4.0 * abs(row + col - (side - 1))


# --- against the naive twin ---------------------------------------------------------------------


@pytest.mark.parametrize("holes", terrains.HOLES)
@pytest.mark.parametrize(
    "shape", [(2, 2), (3, 3), (2, 9), (5, 3), (6, 9), (9, 9), (9, 17)], ids=str
)
def test_is_the_twins_mesh_on_every_shape_and_hole(shape, holes):
    for number, terrain in enumerate(terrains.GALLERY.values()):
        heights = terrains.pierced(terrain(shape), terrains.HOLES[holes](shape))
        if terrains.has_a_triangle(heights):
            grid = grid_of(heights)
            tolerance = [0.0, 0.5, 3.0, 20.0][number % 4]
            _, triangles = naive.least_on_either_diagonal(grid.heights, tolerance)
            assert_same(best(grid, max_error=tolerance), grid, triangles)


@given(terrains.rasters(), terrains.tolerances)
def test_is_the_twins_mesh_on_any_terrain(heights, tolerance):
    grid = grid_of(heights)
    _, triangles = naive.least_on_either_diagonal(grid.heights, tolerance)
    assert_same(best(grid, max_error=tolerance), grid, triangles)


@given(terrains.rasters(), st.data())
def test_is_the_twins_mesh_for_a_map_of_tolerances(heights, data):
    grid = grid_of(heights)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    choices = data.draw(st.sampled_from([[0.0, np.inf], [0.5, 2.0, 7.0], [1.0, 1.0, 1.0, 0.0]]))
    tolerance = rng.choice(choices, grid.shape)
    _, triangles = naive.least_on_either_diagonal(grid.heights, tolerance)
    assert_same(best(grid, max_error=tolerance), grid, triangles)


@given(terrains.rasters(), terrains.tolerances, st.data())
def test_keeps_what_must_be_kept(heights, tolerance, data):
    grid = grid_of(heights)
    keep = data.draw(terrains.masks(grid.shape))
    wanted = set_of(keep & ~np.isnan(grid.heights))
    mesh = best(grid, max_error=tolerance, keep=keep)
    _, triangles = naive.least_on_either_diagonal(grid.heights, tolerance, wanted)
    assert_same(mesh, grid, triangles)
    assert wanted & naive.corners_of(naive.finest(grid.heights)) <= vertex_set(mesh, grid)


@given(terrains.rasters(), terrains.tolerances, st.data())
def test_afterwards_chooses_the_smaller_squared_error(heights, threshold, data):
    grid = grid_of(heights)
    exact, size = naive.exact_heights(grid.heights), naive.lattice_size(grid.shape)
    unmarked = data.draw(terrains.masks(grid.shape))
    for options, kept in (
        ({"threshold": threshold}, naive.thresholded(grid.heights, threshold)[1]),
        ({"removable": ~unmarked}, naive.with_outline(grid.heights, set_of(unmarked))[1]),
    ):
        mesh, other = best(grid, **options), rtin.coarsen(grid, **options)
        assert_same(mesh, grid, naive.on_closer_diagonals(kept, exact, np.inf, size))
        np.testing.assert_array_equal(mesh.vertices, other.vertices)
        assert rtin.vertical_error(mesh, grid).rms <= rtin.vertical_error(other, grid).rms + 1e-12


# --- budgets ------------------------------------------------------------------------------------

SIZE_OF = {"max_vertices": lambda mesh: len(naive.corners_of(mesh)), "max_triangles": len}


def assert_is_the_finest_that_fits(grid, name, budget, meshes, keep=None):
    fitting = [mesh for _, mesh in meshes if SIZE_OF[name](mesh) <= budget]
    if not fitting:
        with pytest.raises(ValueError, match=f"{name} must be at least .*, got {budget}"):
            best(grid, keep=keep, **{name: budget})
        return
    mesh = best(grid, keep=keep, **{name: budget})
    assert naive.corners_of(fitting[-1]) == vertex_set(mesh, grid)
    achieved = rtin.vertical_error(mesh, grid).max
    assert same_bytes(mesh, best(grid, keep=keep, max_error=achieved))
    validity.check(mesh)


@settings(max_examples=40)
@given(terrains.rasters(largest=6), st.sampled_from(list(SIZE_OF)), st.data())
def test_a_budget_gives_the_finest_mesh_that_fits(heights, name, data):
    grid = grid_of(heights)
    keep = data.draw(st.none() | terrains.masks(grid.shape))
    wanted = set() if keep is None else set_of(keep & ~np.isnan(grid.heights))
    meshes = naive.family_on_either_diagonal(grid.heights, wanted)
    sizes = {SIZE_OF[name](mesh) for _, mesh in meshes}
    for budget in sorted({max(1, size + step) for size in sizes for step in (-1, 0)}):
        assert_is_the_finest_that_fits(grid, name, budget, meshes, keep)


@pytest.mark.parametrize("name", SIZE_OF)
@pytest.mark.parametrize("terrain", ["waves", "noise", "staircase"])
def test_a_budget_gives_the_finest_mesh_of_real_looking_terrain(terrain, name):
    grid = grid_of(terrains.GALLERY[terrain]((9, 9)))
    meshes = naive.family_on_either_diagonal(grid.heights)
    for budget in range(2, 130, 9):
        assert_is_the_finest_that_fits(grid, name, budget, meshes)


def test_a_budget_on_real_terrain_is_the_mesh_of_the_error_it_achieves():
    grid = rtin.Grid(rtin.samples.jacksboro_fault().heights[60:125, 90:155] / 3.0)
    for budget in range(60, 3000, 60):
        mesh = best(grid, max_vertices=budget)
        assert 0.9 * budget < mesh.n_vertices <= budget
        achieved = rtin.vertical_error(mesh, grid).max
        assert same_bytes(mesh, best(grid, max_error=achieved))
        assert achieved < rtin.vertical_error(rtin.coarsen(grid, max_vertices=budget), grid).max


@pytest.mark.parametrize(("seed", "budget"), [(211, 11), (663, 15), (1712, 20)])
def test_a_square_swapped_for_one_triangle_stays_so_when_the_other_is_taken_back(seed, budget):
    rng = np.random.default_rng(seed)  # these few among thousands showed it
    heights = rng.integers(0, 4, (9, 9)) + 4 * (seed % 2) * (rng.random((9, 9)) < 0.1)
    grid = grid_of(heights)
    mesh = best(grid, max_vertices=budget)
    achieved = rtin.vertical_error(mesh, grid).max
    assert same_bytes(mesh, best(grid, max_error=achieved))


# --- against all meshes of a small lattice ------------------------------------------------------


class AllMeshes:
    """Every closed set of a lattice as a row of booleans, with any choice of diagonals."""

    def __init__(self, size):
        self.size = size
        self.vertices = list(np.ndindex(size + 1, size + 1))
        sets = naive.closed_sets(size)
        self.has_vertex = np.array([[vertex in kept for vertex in self.vertices] for kept in sets])

    def has(self, vertex):
        return self.has_vertex[:, self.vertices.index(vertex)]

    def within(self, exact, tolerance):
        """Which sets are the vertices of a mesh whose triangles are all good."""
        right = np.ones(len(self.has_vertex), bool)
        for vertex, pair in naive.bisections(self.size).items():
            good = [naive.is_good(t, exact, tolerance) for t in pair]
            bad = np.any(
                [self.has(t[0]) for t, fits in zip(pair, good, strict=True) if not fits], 0
            )
            if naive.fits_turned(vertex, self.size, exact, tolerance):
                bad &= ~np.all([self.has(t[0]) for t in pair], axis=0)
            right &= ~bad | self.has(vertex)
        return right


@pytest.fixture(scope="module", params=[1, 2, 4])
def all_meshes(request):
    return AllMeshes(request.param)


def test_is_least_among_all_meshes_within_the_tolerance(all_meshes):
    size = all_meshes.size
    rng = np.random.default_rng(size)
    n_fewer = 0
    for number, tolerance in product(range(40), (0.0, 0.5, 1.0, 2.0)):
        heights = rng.integers(0, 2 + number // 8, (size + 1, size + 1)).astype(np.float32)
        grid = rtin.Grid(heights)
        within = all_meshes.within(naive.exact_heights(heights), tolerance)
        kept = vertex_set(best(grid, max_error=tolerance), grid)
        ours = np.array([vertex in kept for vertex in all_meshes.vertices])
        assert (all_meshes.has_vertex[within] == ours).all(axis=1).any()
        assert (all_meshes.has_vertex[within] >= ours).all()
        n_fewer += len(kept) < rtin.coarsen(grid, max_error=tolerance).n_vertices
    assert n_fewer >= {1: 0, 2: 1, 4: 10}[size]


# --- laws ---------------------------------------------------------------------------------------


@given(terrains.rasters(), terrains.tolerances)
def test_keeps_the_promise_at_every_sample(heights, tolerance):
    grid = grid_of(heights, transform=terrains.TRANSFORMS["oblong cells"])
    mesh = best(grid, max_error=tolerance)
    error = rtin.vertical_error(mesh, grid)
    assert error.max <= tolerance
    assert error.n_samples == len(naive.corners_of(naive.finest(grid.heights)))
    field = naive.surface_minus_samples(mesh, grid)
    assert np.nanmax(abs(field)) <= tolerance + 1e-6


@given(terrains.rasters(), terrains.tolerances, terrains.tolerances)
def test_keeps_some_of_the_vertices_of_the_lattices_mesh(heights, one, other):
    grid = grid_of(heights)
    finer, coarser = sorted([one, other])
    kept = [vertex_set(best(grid, max_error=tolerance), grid) for tolerance in (finer, coarser)]
    assert kept[0] <= vertex_set(rtin.coarsen(grid, max_error=finer), grid)
    assert kept[1] <= kept[0]


@given(terrains.rasters(largest=9), terrains.tolerances)
def test_conforms_and_covers_exactly_what_has_heights(heights, tolerance):
    grid = grid_of(heights)
    for name in ("max_error", "threshold"):
        mesh = best(grid, **{name: tolerance})
        at = naive.places(mesh, grid)
        triangles = [(at[apex], at[a], at[b]) for a, b, apex in mesh.triangles]
        assert naive.is_conforming(triangles)
        units = [unit for triangle in triangles for unit in unit_triangles(triangle)]
        assert len(units) == len(set(units))
        assert set(units) == naive.finest(grid.heights)


def unit_triangles(triangle):
    """The finest triangles inside one: its edges run along theirs, whatever its diagonal."""
    if naive.is_unit(triangle):
        return [frozenset(triangle)]
    return [unit for half in naive.halves(triangle) for unit in unit_triangles(half)]


@pytest.mark.parametrize("transform", terrains.TRANSFORMS)
@pytest.mark.parametrize("holes", ["none", "pond", "scattered"])
def test_is_a_right_mesh_under_every_transform(transform, holes):
    shape = (17, 23)
    heights = terrains.pierced(terrains.waves(shape), terrains.HOLES[holes](shape))
    grid = grid_of(heights, transform=terrains.TRANSFORMS[transform])
    mesh = best(grid, max_error=4.0)
    validity.check(mesh)
    assert (mesh.signed_areas() > 0.0).all()
    at = np.array(naive.places(mesh, grid))
    assert (np.diff(at @ [shape[1], 1]) > 0).all()  # row-major
    np.testing.assert_array_equal(mesh.vertices[:, 2], grid.heights[tuple(at.T)])
    a, b, apex = (at[corner] for corner in mesh.triangles.T)
    legs = a - apex, b - apex
    assert ((legs[0] * legs[1]).sum(axis=1) == 0).all()
    assert ((legs[0] ** 2).sum(axis=1) == (legs[1] ** 2).sum(axis=1)).all()
    cells = mesh.signed_areas().sum() / abs(grid.transform.determinant)
    assert cells == pytest.approx(len(naive.finest(grid.heights)) / 2, rel=1e-9)


@pytest.mark.parametrize("transform", ["north up", "south up"])
def test_turned_triangles_stand_where_those_of_the_lattice_would(transform):
    grid = grid_of(terrains.waves((33, 33)), transform=terrains.TRANSFORMS[transform])
    mesh, lattice = (
        rtin.coarsen(grid, threshold=3.0, diagonals=choice) for choice in ("best", "lattice")
    )
    at = np.array(naive.places(mesh, grid))
    assert (mesh.vertices == lattice.vertices).all()
    turned = (np.sort(mesh.triangles, axis=1) != np.sort(lattice.triangles, axis=1)).any(axis=1)
    assert 10 < turned.sum() < len(turned) - 10
    np.testing.assert_array_equal(mesh.triangles[~turned], lattice.triangles[~turned])
    middle = at[lattice.triangles[:, :2]].sum(axis=1)  # twice
    np.testing.assert_array_equal(middle, at[mesh.triangles[:, :2]].sum(axis=1))
    apex, shared = lattice.triangles[turned, 2], mesh.triangles[turned]
    assert ((shared[:, 0] == apex) | (shared[:, 1] == apex)).all()
    starts = 1 if transform == "south up" else 0
    np.testing.assert_array_equal(shared[:, starts], apex)


@given(terrains.rasters(), terrains.tolerances, st.integers(-9, 9), st.integers(-9, 9))
def test_ignores_a_tilt_of_the_terrain(heights, tolerance, row_slope, col_slope):
    row, col = np.indices(heights.shape)
    grids = grid_of(heights), grid_of(heights + row_slope * row + col_slope * col + 100)
    for criterion in ("max_error", "threshold"):
        level, tilted = (best(grid, **{criterion: tolerance}) for grid in grids)
        np.testing.assert_array_equal(level.triangles, tilted.triangles)
        np.testing.assert_array_equal(level.vertices[:, :2], tilted.vertices[:, :2])


@given(terrains.rasters(), terrains.tolerances)
def test_transposes_with_the_terrain(heights, tolerance):
    grid, transposed = grid_of(heights), grid_of(heights.T)
    for criterion in ("max_error", "threshold"):
        mesh, other = (best(g, **{criterion: tolerance}) for g in (grid, transposed))
        assert naive.triangles_of(mesh, grid) == {
            frozenset((row, col) for col, row in triangle)
            for triangle in naive.triangles_of(other, transposed)
        }


@given(terrains.rasters())
def test_zero_is_lossless(heights):
    grid = grid_of(heights)
    assert rtin.vertical_error(best(grid, max_error=0), grid).max == 0.0


@pytest.mark.parametrize("side", [3, 5, 9, 33])
def test_a_valley_along_either_diagonal_takes_two_triangles(side):
    valley = valley_off_the_lattices_diagonal(side)
    assert rtin.coarsen(grid_of(valley), max_error=0).n_triangles > 2
    assert best(grid_of(valley), max_error=0).n_triangles == 2
    assert best(grid_of(valley[:, ::-1]), max_error=0).n_triangles == 2


def test_a_valley_along_a_rotated_squares_other_diagonal_takes_no_vertex():
    _, col = np.indices((5, 5))
    heights = abs(col - 1)  # the square about (2, 1) has its own diagonal from (2, 0) to (2, 2)
    keep = np.zeros((5, 5), bool)
    keep[[1, 3], [1, 1]] = True
    own, mesh = (
        rtin.coarsen(grid_of(heights), max_error=0, keep=keep, diagonals=choice)
        for choice in ("lattice", "best")
    )
    places = [vertex_set(m, grid_of(heights)) for m in (own, mesh)]
    assert places[0] - places[1] == {(2, 1)}


def test_a_flat_square_stays_on_the_lattices_diagonal():
    grid = grid_of(np.zeros((9, 9)))
    assert same_bytes(best(grid, max_error=0), rtin.coarsen(grid, max_error=0))


def test_lattice_is_the_default_and_has_the_lattices_meshes():
    grid = grid_of(terrains.waves((33, 20)))
    options = {"max_error": 3.0}, {"threshold": 3.0}, {"max_vertices": 100}
    for option in options:
        assert same_bytes(
            rtin.coarsen(grid, **option), rtin.coarsen(grid, diagonals="lattice", **option)
        )


@pytest.mark.parametrize("tolerance", [0.5, 7.0, 100.0])
def test_takes_fewer_vertices_of_real_terrain_for_the_same_promise(tolerance):
    for grid in (rtin.samples.jacksboro_fault(), rtin.samples.topobathy()):
        mesh, lattice = best(grid, max_error=tolerance), rtin.coarsen(grid, max_error=tolerance)
        error = rtin.vertical_error(mesh, grid)
        assert error.max <= tolerance
        assert error.n_uncovered == 0
        assert mesh.n_vertices < 0.99 * lattice.n_vertices
        validity.check(mesh)


@pytest.mark.parametrize("seed", range(3))
def test_keeps_its_promise_on_heights_that_float32_cannot_hold(seed):
    relief = np.random.default_rng(seed).random((17, 17)) * 4e-3
    grid = rtin.Grid(1e8 + relief)
    mesh = best(grid, max_error=1e-3)
    assert 4 < mesh.n_vertices < 289
    assert rtin.vertical_error(mesh, grid).max <= 1e-3 + np.spacing(1e8)


# --- threads ------------------------------------------------------------------------------------


def families(grid):
    keep = np.zeros(grid.shape, bool)
    keep[5::17, 3::13] = True
    tolerance = np.where(np.indices(grid.shape)[1] < 60, 0.2, np.inf)
    yield best(grid, max_error=3.0)
    yield best(grid, max_error=tolerance, keep=keep)
    yield best(grid, threshold=3.0, keep=keep)
    yield best(grid, removable=~keep)
    yield best(grid, max_vertices=45_000)


@pytest.mark.parametrize("holes", ["none", "pond"])
@pytest.mark.parametrize("shape", [(257, 257), (150, 310), (600, 90)], ids=str)
def test_number_of_threads_changes_no_byte(monkeypatch, shape, holes):
    heights = terrains.waves(shape) + terrains.noise(shape) / 16
    grid = rtin.Grid(terrains.pierced(heights, terrains.HOLES[holes](shape)))
    monkeypatch.setattr("rtin._parallel._FEWEST_ROWS", 32)
    meshes = []
    for n_threads in ("1", "2", "5"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        meshes.append(list(families(grid)))
    for one, other in pairwise(meshes):
        assert all(map(same_bytes, one, other))


@given(terrains.rasters(largest=20), terrains.tolerances, st.sampled_from([2, 3, 5]))
def test_bands_of_rows_change_no_byte(heights, tolerance, rows_in_a_band):
    from rtin import _parallel, coarsening

    grid = grid_of(heights)
    whole = [best(grid, **{name: tolerance}) for name in ("max_error", "threshold")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_parallel, "_FEWEST_ROWS", rows_in_a_band)
        patch.setattr(coarsening, "_COARSE_PARTS", 1)
        cut = [best(grid, **{name: tolerance}) for name in ("max_error", "threshold")]
    assert all(map(same_bytes, whole, cut))


# --- what comes after, and the door -------------------------------------------------------------


def test_its_meshes_can_be_refined_and_measured():
    grid = grid_of(terrains.waves((33, 33)))
    mesh = best(grid, max_error=4.0)
    for scheme in ("4T-LE", "4T-SS", "bisection"):
        validity.check(rtin.refine(mesh, [0, 5, 9], scheme=scheme))
    assert len(rtin.propagation(mesh)[0]) == mesh.n_triangles
    finer = rtin.refine_to(mesh, grid, max_error=1.0)
    assert rtin.vertical_error(finer, grid).max <= 1.0
    adaptive = rtin.AdaptiveMesh(mesh)
    adaptive.refine(np.arange(mesh.n_triangles))
    validity.check(adaptive.mesh)


@pytest.mark.parametrize("value", ["worst", "", None, True], ids=str)
def test_wants_one_of_two_words(value):
    with pytest.raises(ValueError, match=r"diagonals must be 'lattice' or 'best', got"):
        rtin.coarsen(grid_of(np.zeros((3, 3))), max_error=1, diagonals=value)
