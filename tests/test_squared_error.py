"""`norm="rms"` against direct evaluation, all meshes of small lattices, and laws."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive
import rtin
import terrains
from rtin import squared_error, validity

WEIGHTS = [0.0, 0.0078125, 0.25, 1.0, 4.5, 30.0, 400.0, 1e5, float("inf")]


def grid_of(heights, **options):
    return rtin.Grid(np.asarray(heights, dtype=np.float32), **options)


def vertex_set(mesh, grid):
    return set(naive.places(mesh, grid))


def kept_places(grid, keep):
    return {tuple(place) for place in np.argwhere(keep & ~np.isnan(grid.heights)).tolist()}


# --- gains --------------------------------------------------------------------------------------


def assert_are_the_gains(gains, heights, rounding):
    exact = naive.exact_heights(heights)
    for place in np.ndindex(heights.shape):
        expected = naive.gain(place, exact, naive.lattice_size(heights.shape))
        if expected is None:
            assert np.isnan(gains[place])
        else:
            assert abs(gains[place] - float(expected)) <= rounding


@given(terrains.rasters(largest=6))
def test_gains_are_differences_of_sums_of_squares(heights):
    grid = grid_of(heights)
    assert_are_the_gains(squared_error.vertex_gains(grid), grid.heights, 0.0)


@pytest.mark.parametrize("shape", [(9, 9), (9, 17), (17, 5), (2, 17)], ids=str)
@pytest.mark.parametrize("base", [0.0, 8000.0])
def test_gains_lose_no_digits_to_height(shape, base):
    rng = np.random.default_rng(shape)
    heights = base + rng.normal(size=shape).cumsum(axis=0).cumsum(axis=1)
    grid = rtin.Grid(heights)
    assert grid.heights.dtype == np.float64
    assert_are_the_gains(squared_error.vertex_gains(grid), heights, 1e-9 * heights.var())


def test_gains_of_a_plane_are_nothing():
    gains = squared_error.vertex_gains(grid_of(terrains.tilted((33, 33))))
    assert (gains == 0.0).all()


def test_gains_add_up_to_the_error_of_two_triangles():
    heights = terrains.noise((17, 17))
    grid = grid_of(heights)
    coarsest = rtin.coarsen(grid, max_error=np.inf)
    assert coarsest.n_triangles == 2
    total = sum_of_squares(coarsest, grid)
    assert squared_error.vertex_gains(grid).sum() == pytest.approx(total, rel=1e-12)


def sum_of_squares(mesh, grid):
    return float(np.nansum(rtin.vertical_error(mesh, grid).field ** 2))


# --- against all meshes -------------------------------------------------------------------------


class AllMeshes:
    """Every conforming mesh of a raster, with its vertices' number and its sum of squares.

    Heights must be such that float64 rounds nothing.
    """

    def __init__(self, heights, keep=()):
        size = naive.lattice_size(heights.shape)
        exact = naive.exact_heights(heights)
        self.columns = {place: n for n, place in enumerate(np.ndindex(size + 1, size + 1))}
        has = membership(size, outline(heights, keep), free_vertices(heights), self.columns)
        squares, self.is_used = np.zeros(has.shape), np.zeros(has.shape, bool)
        for triangle in naive.all_triangles(size):
            is_there = has[:, self.columns[triangle[0]]].copy()
            if not naive.is_unit(triangle):
                is_there &= ~has[:, self.columns[naive.midpoint(triangle)]]
            if is_there.any() and all(corner in exact for corner in triangle):
                self.is_used[np.ix_(is_there, [self.columns[corner] for corner in triangle])] = True
                for place, error in naive.errors_in(triangle, exact).items():
                    squares[is_there, self.columns[place]] = float(error * error)
        self.sums, self.n_vertices = squares.sum(axis=1), self.is_used.sum(axis=1)

    def best(self, weight):
        """The vertices of the smallest mesh of the least sum of squares + weight × vertices."""
        costs = self.n_vertices if weight == np.inf else self.sums + weight * self.n_vertices
        best = np.flatnonzero(costs == costs.min())
        smallest = self.is_used[best[self.n_vertices[best].argmin()]]
        assert (self.is_used[best] >= smallest).all()
        return {place for place, column in self.columns.items() if smallest[column]}


def outline(heights, keep):
    return frozenset(naive.least(heights, float("inf"), keep)[0])


def free_vertices(heights):
    """Those of which a mesh may have any, as far as it is closed."""
    size, exact = naive.lattice_size(heights.shape), naive.exact_heights(heights)
    return [v for v in naive.bisections(size) if naive.gain(v, exact, size) is not None]


def membership(size, base, free, columns):
    """A row for each closed set that holds the base and none but free ones: which it holds."""
    if size <= 4:
        has = membership_in_all(size)
        held = np.array([place in base for place in columns])
        allowed = held | np.array([place in set(free) for place in columns])
        return has[(has >= held).all(axis=1) & (has <= allowed).all(axis=1)]
    sets = naive.closed_sets(size, base, free)
    return np.array([[place in kept for place in columns] for kept in sets])


@cache
def membership_in_all(size):
    places = list(np.ndindex(size + 1, size + 1))
    return np.array([[place in kept for place in places] for kept in naive.closed_sets(size)])


def test_there_are_as_many_meshes_as_should_be():
    assert len(AllMeshes(np.zeros((5, 5))).sums) == 5489


@pytest.mark.parametrize("terrain", terrains.GALLERY)
def test_is_the_best_of_all_meshes_of_a_lattice(terrain):
    heights = terrains.GALLERY[terrain]((5, 5))
    grid, meshes = grid_of(heights), AllMeshes(heights)
    for weight in WEIGHTS:
        mesh = rtin.coarsen(grid, norm="rms", weight=weight)
        assert vertex_set(mesh, grid) == meshes.best(weight)
        validity.check(mesh)


@pytest.mark.parametrize("shape", [(3, 3), (3, 5), (5, 3), (3, 6), (2, 9), (3, 7), (4, 5)], ids=str)
def test_is_the_best_of_all_meshes_of_a_strip(shape):
    for seed in range(6):
        heights = terrains.noise(shape, seed) / 16 if seed % 2 else terrains.waves(shape)
        heights = np.round(16 * heights) / 16
        grid, meshes = grid_of(heights), AllMeshes(heights)
        for weight in WEIGHTS:
            mesh = rtin.coarsen(grid, norm="rms", weight=weight)
            assert vertex_set(mesh, grid) == meshes.best(weight)


@given(terrains.rasters(largest=5), st.sampled_from(WEIGHTS), st.data())
def test_is_the_best_of_all_meshes_around_voids_and_what_is_kept(heights, weight, data):
    grid = grid_of(heights)
    keep = data.draw(st.none() | terrains.masks(grid.shape))
    wanted = () if keep is None else kept_places(grid, keep)
    mesh = rtin.coarsen(grid, norm="rms", weight=weight, keep=keep)
    assert vertex_set(mesh, grid) == AllMeshes(grid.heights, wanted).best(weight)


def size_of(mesh, name):
    return mesh.n_vertices if name == "max_vertices" else mesh.n_triangles


@given(terrains.rasters(largest=5), st.sampled_from(["max_vertices", "max_triangles"]))
def test_a_budget_gets_at_least_the_best_set_that_fits(heights, name):
    grid = grid_of(heights)
    meshes = [rtin.coarsen(grid, norm="rms", weight=weight) for weight in WEIGHTS]
    sets = [vertex_set(mesh, grid) for mesh in meshes]
    least = size_of(meshes[-1], name)
    for budget in {least, least + 1, least + 4, *(size_of(mesh, name) - 1 for mesh in meshes)}:
        if budget < least:
            continue
        mesh = rtin.coarsen(grid, norm="rms", **{name: budget})
        validity.check(mesh)
        assert size_of(mesh, name) <= budget
        for best, vertices in zip(meshes, sets, strict=True):
            if size_of(best, name) <= budget:
                assert vertices <= vertex_set(mesh, grid)
                assert sum_of_squares(mesh, grid) <= sum_of_squares(best, grid)


def test_a_budget_that_a_best_set_fills_gets_that_set():
    grid = grid_of(terrains.noise((33, 33)))
    for weight in (3.0, 50.0, 700.0, 4000.0, 1e4):
        best = rtin.coarsen(grid, norm="rms", weight=weight)
        for options in ({"max_vertices": best.n_vertices}, {"max_triangles": best.n_triangles}):
            mesh = rtin.coarsen(grid, norm="rms", **options)
            assert mesh.vertices.tobytes() == best.vertices.tobytes()


# --- laws ---------------------------------------------------------------------------------------

REAL = {
    "jacksboro": rtin.samples.jacksboro_fault,
    "topobathy": rtin.samples.topobathy,
    "complete": lambda: rtin.Grid(rtin.samples.jacksboro_fault().heights[:257, :257]),
    "holes": lambda: rtin.Grid(
        terrains.pierced(
            rtin.samples.topobathy().heights, terrains.pond(rtin.samples.topobathy().shape)
        )
    ),
}


@pytest.mark.parametrize("real", REAL)
def test_best_meshes_are_nested(real):
    grid = REAL[real]()
    coarser = set()
    for weight in (np.inf, 1e6, 1e5, 3e4, 3e3, 30.0, 0.0):
        mesh = rtin.coarsen(grid, norm="rms", weight=weight)
        finer = vertex_set(mesh, grid)
        assert coarser <= finer
        coarser = finer
    assert rtin.vertical_error(mesh, grid).max == 0.0


@pytest.mark.parametrize("real", REAL)
def test_rms_is_below_that_of_the_other_meshes_of_as_many_vertices(real):
    grid = REAL[real]()
    for others in ({"max_error": 20.0}, {"threshold": 10.0}, {"max_vertices": 5000}):
        other = rtin.coarsen(grid, **others)
        mesh = rtin.coarsen(grid, norm="rms", max_vertices=other.n_vertices)
        assert mesh.n_vertices <= other.n_vertices
        ratio = rtin.vertical_error(mesh, grid).rms / rtin.vertical_error(other, grid).rms
        assert 0.5 < ratio < 0.97


@pytest.mark.parametrize("real", REAL)
@pytest.mark.parametrize("name", ["max_vertices", "max_triangles"])
def test_the_room_of_a_budget_is_used_and_never_exceeded(real, name):
    grid = REAL[real]()
    least = size_of(rtin.coarsen(grid, max_error=np.inf), name)
    lossless = size_of(rtin.coarsen(grid, max_error=0), name)
    for more in (0, 1, 17, 1777, 9000):
        mesh = rtin.coarsen(grid, norm="rms", **{name: least + more})
        most = min(least + more, lossless)
        assert most - 1 <= size_of(mesh, name) <= most
        validity.check(mesh)


def test_of_equal_parts_as_many_are_kept_as_fit():
    """Sixteen pits that gain the same and don't need each other, between vertices to keep."""
    heights, keep = np.zeros((129, 129)), np.zeros((129, 129), bool)
    heights[12::32, 12::32] = -16.0
    keep[::8, ::8] = True
    grid = grid_of(heights)
    without = rtin.coarsen(grid, norm="rms", weight=np.inf, keep=keep).n_vertices
    everything = rtin.coarsen(grid, max_error=0, keep=keep).n_vertices
    n_each, rest = divmod(everything - without, 16)
    assert rest == 0
    for n_pits in (0, 1, 5, 15, 16):
        for more in (0, n_each - 1):
            budget = without + n_pits * n_each + more
            mesh = rtin.coarsen(grid, norm="rms", max_vertices=budget, keep=keep)
            assert np.count_nonzero(mesh.vertices[:, 2]) == n_pits
            assert sum_of_squares(mesh, grid) == 256.0 * (16 - n_pits)


def test_a_budget_of_everything_is_lossless():
    grid = grid_of(terrains.noise((9, 12)))
    for options in ({"max_vertices": 10**6}, {"max_triangles": 2**62}, {"max_vertices": 108}):
        mesh = rtin.coarsen(grid, norm="rms", **options)
        assert rtin.vertical_error(mesh, grid).max == 0.0
    flat = rtin.coarsen(grid_of(np.full((33, 33), 7.0)), norm="rms", max_vertices=1000)
    assert flat.n_vertices == 4


@given(terrains.rasters(), st.sampled_from(WEIGHTS))
def test_ignores_a_tilt_of_the_terrain(heights, weight):
    row, col = np.indices(heights.shape)
    one, other = grid_of(heights), grid_of(heights + 0.5 * row - 2.0 * col + 64.0)
    one_mesh = rtin.coarsen(one, norm="rms", weight=weight)
    other_mesh = rtin.coarsen(other, norm="rms", weight=weight)
    assert (one_mesh.triangles == other_mesh.triangles).all()


def test_scales_with_the_square_of_the_heights():
    heights = terrains.noise((33, 41))
    one = rtin.coarsen(grid_of(heights), norm="rms", weight=300.0)
    other = rtin.coarsen(grid_of(4 * heights), norm="rms", weight=4800.0)
    assert one.triangles.tobytes() == other.triangles.tobytes()


def test_lies_as_the_raster_does():
    heights = terrains.waves((17, 23))
    plain = rtin.coarsen(grid_of(heights), norm="rms", weight=9.0)
    for transform in terrains.TRANSFORMS.values():
        grid = grid_of(heights, transform=transform)
        mesh = rtin.coarsen(grid, norm="rms", weight=9.0)
        assert vertex_set(mesh, grid) == vertex_set(plain, grid_of(heights))
        validity.check(mesh)


@pytest.mark.parametrize("options", [{"weight": 2000.0}, {"max_vertices": 7001}])
def test_gives_the_same_bytes_on_any_number_of_threads(options, monkeypatch):
    rng = np.random.default_rng(1)
    grid = grid_of(rng.normal(size=(600, 530)).cumsum(axis=0).cumsum(axis=1))
    meshes = []
    for n_threads in ("1", "2"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        meshes.append(rtin.coarsen(grid, norm="rms", **options))
    assert meshes[0].vertices.tobytes() == meshes[1].vertices.tobytes()
    assert meshes[0].triangles.tobytes() == meshes[1].triangles.tobytes()


def test_the_cut_is_as_good_as_the_flow():
    """Strong duality on real terrain: no closed set can gain more than what flow leaves over."""
    from rtin._kernels import squared_error as kernels

    grid = REAL["complete"]()
    gains = squared_error.vertex_gains(grid)
    kept = np.zeros((257, 264), np.uint8)
    kept[::256, :257:256] = 1
    number = np.full(grid.shape, -1, np.int32)
    weight = 5000.0
    items = kernels.candidates(gains, weight, kept, number)
    heads, incoming = kernels.link(items, number)
    assert (number == -1).all()
    worth = kernels.gains_of(items, gains) - weight
    left = worth.copy()
    kernels.make_up_for_losses(heads, incoming, left)
    chosen = kernels.best_closed_set(items, gains, weight, number)
    assert 100 < chosen.sum() < items.size
    assert worth[chosen].sum() == pytest.approx(left[left > 0.0].sum(), rel=1e-13)


# --- the door -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"norm": "rms"}, "exactly one of max_vertices, max_triangles, weight; got none"),
        ({"norm": "rms", "max_vertices": 9, "weight": 1.0}, "exactly one .* max_vertices, weight"),
        ({"norm": "rms", "max_error": 1.0}, "max_error does not go with norm='rms'; give exactly"),
        ({"norm": "rms", "threshold": 1.0, "weight": 1.0}, "threshold does not go with norm='rms'"),
        ({"norm": "rms", "removable": np.ones((9, 9), bool)}, "removable does not go with"),
        ({"weight": 1.0}, "weight does not go with norm='max'"),
        ({"weight": 1.0, "max_error": 1.0}, "weight does not go with norm='max'"),
        ({"norm": "l2", "max_vertices": 9}, "norm must be 'max' or 'rms', got 'l2'"),
        ({"norm": ["rms"], "max_vertices": 9}, "norm must be 'max' or 'rms', got"),
        ({"norm": "rms", "weight": -1.0}, "weight must be zero or more, in squares of .* got -1.0"),
        ({"norm": "rms", "weight": np.nan}, "weight must be zero or more"),
        ({"norm": "rms", "max_vertices": 3}, "max_vertices must be at least 4 .* got 3"),
        ({"norm": "rms", "max_triangles": 1}, "max_triangles must be at least 2 .* got 1"),
    ],
)
def test_says_what_is_wrong(options, message):
    with pytest.raises(ValueError, match=message):
        rtin.coarsen(grid_of(terrains.noise((9, 9))), **options)


@pytest.mark.parametrize("options", [{"weight": "1"}, {"weight": True}, {"max_vertices": 9.0}])
def test_says_what_kind_is_wanted(options):
    with pytest.raises(TypeError, match="must be a"):
        rtin.coarsen(grid_of(terrains.noise((9, 9))), norm="rms", **options)


def test_a_raster_without_a_triangle_has_no_mesh():
    heights = np.array([[1.0, np.nan], [np.nan, np.nan]])
    for options in ({"weight": 1.0}, {"max_vertices": 5}):
        with pytest.raises(ValueError, match="no triangle to keep"):
            rtin.coarsen(grid_of(heights), norm="rms", **options)
