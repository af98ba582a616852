"""`norm="rms"` against direct evaluation, all meshes of small lattices, and the mathematics' laws."""

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


@given(terrains.rasters())
def test_gains_are_differences_of_sums_of_squares(heights):
    grid = grid_of(heights)
    assert_are_the_gains(squared_error.vertex_gains(grid), grid.heights, 0.0)


@pytest.mark.parametrize("shape", [(17, 17), (9, 17), (17, 12), (2, 17)], ids=str)
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
    return float(np.nansum(naive.surface_minus_samples(mesh, grid) ** 2))


# --- against all meshes -------------------------------------------------------------------------


class AllMeshes:
    """Every conforming mesh of a raster, with its vertices' number and its sum of squares.

    Heights must be such that float64 rounds nothing.
    """

    def __init__(self, heights, keep=()):
        size = naive.lattice_size(heights.shape)
        exact = naive.exact_heights(heights)
        base = frozenset(naive.least(heights, float("inf"), keep)[0])
        free = [v for v in naive.bisections(size) if naive.gain(v, exact, size) is not None]
        self.sets = naive.closed_sets(size, base, free)
        triangles = naive.all_triangles(size)
        columns = {vertex: number for number, vertex in enumerate(np.ndindex(size + 1, size + 1))}
        has = np.zeros((len(self.sets), len(columns)), bool)
        for row, kept in zip(has, self.sets, strict=True):
            row[[columns[vertex] for vertex in kept]] = True
        squares = np.zeros((len(self.sets), len(columns)))
        is_used = np.zeros((len(self.sets), len(columns)), bool)
        for triangle in triangles:
            if not all(corner in exact for corner in triangle):
                continue
            is_there = has[:, columns[triangle[0]]].copy()
            if not naive.is_unit(triangle):
                is_there &= ~has[:, columns[naive.midpoint(triangle)]]
            for corner in triangle:
                is_used[is_there, columns[corner]] = True
            if is_there.any():
                for place, error in naive.errors_in(triangle, exact).items():
                    squares[is_there, columns[place]] = float(error * error)
        self.sums = squares.sum(axis=1)
        self.n_vertices = is_used.sum(axis=1)
        self.vertices = [
            {vertex for vertex, column in columns.items() if row[column]} for row in is_used
        ]

    def best(self, weight):
        """The vertices of the smallest mesh of the least sum of squares + weight × vertices."""
        if weight == float("inf"):
            return self.vertices[int(self.n_vertices.argmin())]
        costs = self.sums + weight * self.n_vertices
        best = np.flatnonzero(costs == costs.min())
        smallest = best[self.n_vertices[best].argmin()]
        for other in best:
            assert self.vertices[smallest] <= self.vertices[other]
        return self.vertices[smallest]


def test_there_are_as_many_meshes_as_should_be():
    assert len(AllMeshes(np.zeros((5, 5))).sets) == len(naive.conforming_meshes(4)) == 5489


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


@given(terrains.rasters(largest=5), st.sampled_from(["max_vertices", "max_triangles"]))
def test_a_budget_gets_at_least_the_best_set_that_fits(heights, name):
    grid = grid_of(heights)
    meshes = AllMeshes(grid.heights)
    for budget in range(2, 33, 3):
        try:
            mesh = rtin.coarsen(grid, norm="rms", **{name: budget})
        except ValueError as error:
            assert f"{name} must be at least" in str(error)
            continue
        validity.check(mesh)
        assert (mesh.n_vertices if name == "max_vertices" else mesh.n_triangles) <= budget
        ours = sum_of_squares(mesh, grid)
        for weight in WEIGHTS:
            best = rtin.coarsen(grid, norm="rms", weight=weight)
            n_best = best.n_vertices if name == "max_vertices" else best.n_triangles
            if n_best <= budget:
                assert vertex_set(best, grid) <= vertex_set(mesh, grid)
                assert ours <= sum_of_squares(best, grid) + 1e-9
        if name == "max_vertices":
            assert ours >= meshes.sums[meshes.n_vertices <= budget].min() - 1e-9


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
    outline = rtin.coarsen(grid, max_error=np.inf)
    least = outline.n_vertices if name == "max_vertices" else outline.n_triangles
    for more in (0, 1, 17, 1777, 9000):
        mesh = rtin.coarsen(grid, norm="rms", **{name: least + more})
        size = mesh.n_vertices if name == "max_vertices" else mesh.n_triangles
        assert least + more - 1 <= size <= least + more
        validity.check(mesh)


def test_ties_are_filled_up_to_the_last_vertex():
    """Equal pits: the best meshes have none of them or all."""
    heights = np.zeros((65, 65))
    heights[2:-1:4, 2:-1:4] = -16.0
    grid = grid_of(heights)
    for budget in range(200, 1200, 77):
        mesh = rtin.coarsen(grid, norm="rms", max_vertices=budget)
        assert mesh.n_vertices <= budget
    everything = rtin.coarsen(grid, max_error=0).n_vertices
    rms = [
        rtin.vertical_error(rtin.coarsen(grid, norm="rms", max_vertices=budget), grid).rms
        for budget in (everything // 2, everything - 60, everything)
    ]
    assert rms[0] > rms[1] > rms[2] == 0.0


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
        ({"norm": "rms", "weight": -1.0}, "weight must be zero or more, .* got -1.0"),
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
