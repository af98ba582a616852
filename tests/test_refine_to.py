"""`refine_to`: what it promises, beside the least mesh, and what it does not take."""

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import meshes
import naive
import rtin
import terrains
from rtin import validity
from rtin.mesh import TriangleMesh

SCHEMES = meshes.SCHEMES
SQUARE_SIDES = st.sampled_from([2, 3, 5, 9, 17])


@st.composite
def filled_lattices(draw):
    """Heights without voids that fill their lattice."""
    side = draw(SQUARE_SIDES)
    seed, steps = draw(meshes.seeds), draw(st.sampled_from([1, 2, 5, 400]))
    heights = np.random.default_rng(seed).integers(0, steps + 1, (side, side)) / 16.0
    if draw(st.booleans()):
        heights = heights + draw(st.sampled_from(list(terrains.GALLERY.values())))((side, side))
    return heights


def sheet(grid):
    """The two triangles over a whole raster, split along the diagonal from its first sample."""
    last_row, last_col = np.subtract(grid.shape, 1)
    corners = [(0, 0), (last_col, 0), (last_col, last_row), (0, last_row)]
    vertices = [[*(grid.transform @ corner), -99.0] for corner in corners]
    return TriangleMesh.from_triangles(vertices, [[0, 1, 2], [0, 2, 3]])


def cloud(grid, seed, n_points=12, margin=0.0):
    """A TIN over part of a raster, or beyond it with a margin."""
    rng = np.random.default_rng(seed)
    last = np.subtract(grid.shape, 1)[::-1]
    places = (rng.random((n_points, 2)) * (1 + 2 * margin) - margin) * last
    points = np.array([grid.transform @ place for place in places])
    return meshes.delaunay(points, rng)


def worst_excess(mesh, grid, tolerance):
    """Largest abs(surface - sample) - tolerance at a sample that the mesh covers; -inf if none."""
    try:
        field = rtin.vertical_error(mesh, grid).field
    except ValueError:
        return -np.inf
    return np.nanmax(np.where(np.isnan(field), -np.inf, np.abs(field) - tolerance))


# --- max_error ----------------------------------------------------------------------------------


@given(
    terrains.rasters(largest=11, holes=False),
    st.sampled_from(list(meshes.TRANSFORMS)),
    st.sampled_from([0.5, 3.5, 10.0]),
    meshes.schemes,
)
def test_keeps_the_promise_from_two_triangles(heights, transform, max_error, scheme):
    grid = rtin.Grid(heights, meshes.TRANSFORMS[transform])
    mesh = rtin.refine_to(sheet(grid), grid, max_error=max_error, scheme=scheme)
    validity.check(mesh)
    error = rtin.vertical_error(mesh, grid)
    assert error.max <= max_error
    assert (error.n_samples, error.n_uncovered) == (grid.n_samples, 0)
    naive_field = naive.surface_minus_samples(mesh, grid)
    assert np.abs(naive_field).max() <= max_error * (1 + 1e-6)


@given(
    terrains.rasters(largest=11),
    st.sampled_from([40.0, 1e6]),
    st.sampled_from([0.0, 0.5, 3.5]),
    meshes.schemes,
)
def test_keeps_the_promise_from_a_coarsened_mesh(heights, coarse, max_error, scheme):
    grid = rtin.Grid(heights)
    start = rtin.coarsen(grid, max_error=coarse)
    mesh = rtin.refine_to(start, grid, max_error=max_error, scheme=scheme)
    validity.check(mesh)
    assert rtin.vertical_error(mesh, grid).max <= max_error
    assert worst_excess(mesh, grid, max_error) <= 0.0


@given(
    terrains.rasters(largest=11),
    st.sampled_from(["north up", "rotated", "wide cells"]),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([2.0, 10.0]),
    meshes.schemes,
    meshes.seeds,
)
def test_keeps_the_promise_from_a_tin(heights, transform, margin, max_error, scheme, seed):
    """Over part of the raster, or beyond it; with voids."""
    grid = rtin.Grid(heights, meshes.TRANSFORMS[transform])
    start = cloud(grid, seed, margin=margin)
    mesh = rtin.refine_to(start, grid, max_error=max_error, scheme=scheme)
    assert worst_excess(mesh, grid, max_error) <= 0.0
    assert meshes.is_right(mesh)


@given(terrains.rasters(largest=11), meshes.schemes, meshes.seeds, st.booleans())
def test_keeps_the_promise_of_a_map_of_tolerances(heights, scheme, seed, lattice):
    grid = rtin.Grid(heights)
    rng = np.random.default_rng(seed)
    tolerance = rng.choice([0.5, 2.0, 40.0, np.inf], grid.shape)
    tolerance[np.isnan(grid.heights) & (rng.random(grid.shape) < 0.5)] = np.nan
    start = rtin.coarsen(grid, max_error=1e6) if lattice else cloud(grid, seed)
    mesh = rtin.refine_to(start, grid, max_error=tolerance, scheme=scheme)
    field = rtin.vertical_error(mesh, grid).field if worst_excess(mesh, grid, 0) >= 0 else 0.0
    assert not (np.abs(field) > tolerance).any()


@given(
    filled_lattices(), st.sampled_from(list(meshes.TRANSFORMS)), terrains.tolerances, meshes.schemes
)
def test_bisection_from_two_triangles_is_the_least_mesh(heights, transform, max_error, scheme):
    """On a raster that fills its lattice: what `coarsen` gives; the four-triangle schemes add."""
    grid = rtin.Grid(heights, meshes.TRANSFORMS[transform])
    least = rtin.coarsen(grid, max_error=max_error)
    mesh = rtin.refine_to(sheet(grid), grid, max_error=max_error, scheme=scheme)
    assert set(naive.places(mesh, grid)) >= set(naive.places(least, grid))
    if scheme == "bisection":
        assert naive.triangles_of(mesh, grid) == naive.triangles_of(least, grid)
        assert mesh.n_triangles == least.n_triangles


def test_bisection_is_the_least_mesh_on_a_larger_raster_too():
    grid = rtin.Grid(terrains.waves((129, 129)) + terrains.cliff((129, 129)))
    least = rtin.coarsen(grid, max_error=2.0)
    mesh = rtin.refine_to(sheet(grid), grid, max_error=2.0, scheme="bisection")
    assert naive.triangles_of(mesh, grid) == naive.triangles_of(least, grid)
    for scheme in ("4T-LE", "4T-SS"):
        more = rtin.refine_to(sheet(grid), grid, max_error=2.0, scheme=scheme)
        assert more.n_vertices > least.n_vertices


@given(filled_lattices(), st.sampled_from(list(meshes.TRANSFORMS)), meshes.schemes)
def test_no_error_at_all_is_the_lossless_mesh(heights, transform, scheme):
    grid = rtin.Grid(heights, meshes.TRANSFORMS[transform])
    mesh = rtin.refine_to(sheet(grid), grid, max_error=0.0, scheme=scheme)
    assert rtin.vertical_error(mesh, grid).max == 0.0
    for (row, col), z in zip(naive.places(mesh, grid), mesh.vertices[:, 2], strict=True):
        assert z == grid.heights[row, col]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_noise_without_any_error_needs_all_samples(scheme):
    grid = rtin.Grid(terrains.noise((17, 17)))
    mesh = rtin.refine_to(sheet(grid), grid, max_error=0, scheme=scheme)
    assert set(naive.places(mesh, grid)) == set(np.ndindex(17, 17))


@pytest.mark.parametrize("seed", range(4))
def test_without_any_error_from_a_tin_keeps_the_promise_or_says_why_not(seed):
    grid = rtin.Grid(terrains.noise((4, 4), seed))
    start = cloud(grid, seed, n_points=5)
    try:
        mesh = rtin.refine_to(start, grid, max_error=0.0)
    except ValueError as error:
        assert "too small" in str(error)  # noqa: PT017  (both ends are right)
    else:
        assert worst_excess(mesh, grid, 0.0) <= 0.0


# --- threshold ----------------------------------------------------------------------------------


@given(
    terrains.rasters(largest=11),
    st.sampled_from(list(meshes.TRANSFORMS)),
    st.sampled_from([0.0, 0.5, 3.5, 40.0]),
    meshes.schemes,
    meshes.seeds,
)
def test_no_longest_edge_has_a_midpoint_over_the_threshold(
    heights, transform, threshold, scheme, seed
):
    grid = rtin.Grid(heights, meshes.TRANSFORMS[transform])
    for start in (sheet(grid), rtin.coarsen(grid, max_error=40.0), cloud(grid, seed, margin=0.2)):
        mesh = rtin.refine_to(start, grid, threshold=threshold, scheme=scheme)
        assert meshes.is_right(mesh)
        for a, b, _ in mesh.vertices[mesh.triangles]:
            middle = grid.heights_at([(a[:2] + b[:2]) / 2])[0]
            ends = grid.places([a[:2], b[:2]])
            if np.linalg.norm(ends[1] - ends[0]) >= 1.5:
                assert not abs((a[2] + b[2]) / 2 - middle) > threshold


@given(filled_lattices(), terrains.tolerances, meshes.schemes)
def test_a_threshold_refines_what_eq_1_says_and_what_that_takes(heights, threshold, scheme):
    """Top-down, from two triangles: whatever is a vertex was over the threshold, or is beside."""
    grid = rtin.Grid(heights)
    mesh = rtin.refine_to(sheet(grid), grid, threshold=threshold, scheme="bisection")
    size = naive.lattice_size(grid.shape)
    errors = naive.vertex_errors(grid.heights)
    kept = set(naive.places(mesh, grid))
    over = {place for place in kept if errors[place] > threshold}
    closure = over | naive.corners_of_lattice(size)
    assert kept == closure.union(*(naive.ancestors(place, size) for place in over))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_threshold_looks_no_closer_than_the_raster(scheme):
    grid = rtin.Grid(terrains.noise((9, 9)))
    mesh = rtin.refine_to(sheet(grid), grid, threshold=0.0, scheme=scheme)
    assert mesh.n_vertices == 81
    again = rtin.refine_to(mesh, grid, threshold=0.0, scheme=scheme)
    assert again.triangles.tobytes() == mesh.triangles.tobytes()


# --- heights and the rest -----------------------------------------------------------------------


@pytest.mark.parametrize("criterion", ["threshold", "max_error"])
def test_gives_all_vertices_the_rasters_heights_where_it_has_one(criterion):
    heights = terrains.pierced(terrains.waves((9, 9)), terrains.pond((9, 9)))
    grid = rtin.Grid(heights)
    start = meshes.joined(sheet(grid), sheet(grid))  # the second one lies beside the raster
    start = TriangleMesh(start.vertices, start.triangles, "EPSG:2056", [5, 6, 7, 8])
    before = start.vertices.tobytes(), start.triangles.tobytes()
    mesh = rtin.refine_to(start, grid, **{criterion: 1.0})
    assert (start.vertices.tobytes(), start.triangles.tobytes()) == before
    assert mesh.vertices[:8, :2].tobytes() == start.vertices[:, :2].tobytes()
    assert mesh.vertices[:8, 2].tolist() == [*grid.heights[[0, 0, 8, 8], [0, 8, 8, 0]], *[-99] * 4]
    lifted = grid.heights_at(mesh.vertices[:, :2])
    has_one = ~np.isnan(lifted)
    assert has_one.sum() > (20 if criterion == "max_error" else 3)
    assert (mesh.vertices[has_one, 2] == lifted[has_one]).all()
    assert mesh.crs == start.crs
    assert set(mesh.tags) == {5, 6, 7, 8}


def test_changes_nothing_but_heights_where_all_fits():
    grid = rtin.Grid(terrains.tilted((9, 9)))
    start = sheet(grid)
    mesh = rtin.refine_to(start, grid, max_error=0.0)
    assert mesh.triangles.tobytes() == start.triangles.tobytes()
    assert mesh.vertices[:, :2].tobytes() == start.vertices[:, :2].tobytes()
    assert rtin.vertical_error(mesh, grid).max == 0.0


@pytest.mark.parametrize("options", [{"max_error": 2.0}, {"threshold": 2.0}], ids=str)
def test_threads_change_no_byte(monkeypatch, options):
    grid = rtin.Grid(terrains.noise((65, 65)))
    results = []
    for n_threads in ("1", "2", "5"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        mesh = rtin.refine_to(sheet(grid), grid, **options)
        results.append((mesh.vertices.tobytes(), mesh.triangles.tobytes()))
    assert mesh.n_triangles > 1000
    assert results[0] == results[1] == results[2]


def test_takes_part_of_a_raster_in_utm():
    """Promised where the mesh is, and the rest of the raster stays uncovered."""
    transform = terrains.UTM @ Affine.rotation(33.0) @ Affine.scale(2.0, -2.0)
    grid = rtin.Grid(terrains.waves((65, 49)), transform)
    corners = [[*(transform @ place), 0.0] for place in [(3.3, 7.1), (40.2, 9.9), (22.0, 55.5)]]
    mesh = rtin.refine_to(TriangleMesh.from_triangles(corners, [[0, 1, 2]]), grid, max_error=1.0)
    error = rtin.vertical_error(mesh, grid)
    assert error.max <= 1.0
    assert 500 < error.n_samples < 1500


# --- what it does not take ----------------------------------------------------------------------

GRID = rtin.Grid(terrains.noise((5, 5)))
WRONG = {
    "no criterion": ({}, ValueError, "exactly one of threshold, max_error; got none"),
    "both": ({"threshold": 1, "max_error": 1}, ValueError, "one of .* got threshold, max_error"),
    "negative": ({"max_error": -1.0}, ValueError, "max_error must be zero or more, .* got -1"),
    "negative threshold": ({"threshold": -0.5}, ValueError, "threshold must be .* got -0.5"),
    "NaN": ({"max_error": np.nan}, ValueError, "max_error must be zero or more, .* got nan"),
    "NaN threshold": ({"threshold": np.nan}, ValueError, "threshold must be .* got nan"),
    "text": ({"max_error": "5"}, TypeError, "max_error must be a number, got '5'"),
    "truth": ({"max_error": True}, TypeError, "max_error must be a number, got True"),
    "thresholds": ({"threshold": np.ones((5, 5))}, TypeError, r"got an array of shape \(5, 5\)"),
    "short map": ({"max_error": [1, 2]}, ValueError, r"grid's shape \(5, 5\), got .* \(2,\)"),
    "complex map": ({"max_error": np.ones((5, 5)) * 1j}, TypeError, "numbers, got .* complex128"),
    "text map": ({"max_error": [["a"] * 5] * 5}, TypeError, "must hold numbers, got .* <U1"),
    "one negative": (
        {"max_error": np.where(np.arange(25).reshape(5, 5) == 7, -3.0, np.inf)},
        ValueError,
        "max_error must be zero or more, .* got -3.0 at row 1, column 2",
    ),
    "one NaN": (
        {"max_error": np.where(np.arange(25).reshape(5, 5) == 24, np.nan, 1.0)},
        ValueError,
        "got nan at row 4, column 4",
    ),
    "scheme": ({"max_error": 1, "scheme": "4t"}, ValueError, "one of 4T-LE, .* got '4t'"),
    "no mesh": ({"mesh": None, "max_error": 1}, TypeError, "a TriangleMesh is wanted, got None"),
    "no grid": ({"grid": GRID.heights, "max_error": 1}, TypeError, "a Grid is wanted, got nd"),
    "elsewhere": (
        {"mesh": meshes.strip(4, np.random.default_rng(0)), "max_error": 1,
         "grid": rtin.Grid(np.ones((3, 3)), (1, 0, 500, 0, -1, 0))},
        ValueError,
        "the mesh lies beside the grid",
    ),
    "no vertices": (
        {"mesh": TriangleMesh(np.empty((0, 3)), np.empty((0, 3), int)), "max_error": 1},
        ValueError,
        "the mesh lies beside the grid",
    ),
}  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_says_what_was_wanted_and_what_came(wrong):
    options, error, message = WRONG[wrong]
    with pytest.raises(error, match=message) as raised:
        rtin.refine_to(**{"mesh": sheet(GRID), "grid": GRID} | options)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("options", [{"max_error": 1.0}, {"threshold": 1.0}], ids=str)
@pytest.mark.parametrize("place", [[4.0, np.nan], [np.inf, -4.0]], ids=str)
def test_refuses_coordinates_that_are_not_finite(place, options):
    for heights in (np.zeros((5, 5)), terrains.noise((5, 5))):
        vertices = sheet(GRID).vertices.copy()
        vertices[2, :2] = place
        mesh = TriangleMesh(vertices, sheet(GRID).triangles)
        with pytest.raises(validity.InvalidMesh, match="vertex 2 has a coordinate that is not"):
            rtin.refine_to(mesh, rtin.Grid(heights), **options)


@pytest.mark.parametrize("options", [{"max_error": 1.0}, {"threshold": 1.0}], ids=str)
def test_refuses_a_wrong_mesh_even_where_nothing_is_to_be_refined(options):
    mesh = TriangleMesh(sheet(GRID).vertices, sheet(GRID).triangles[:, ::-1])
    with pytest.raises(validity.InvalidMesh, match="is clockwise seen from above"):
        rtin.refine_to(mesh, rtin.Grid(np.zeros((5, 5))), **options)
