"""Each fault, planted one at a time in a right mesh, is found and placed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rtin
import terrains
from rtin import validity
from rtin.mesh import TriangleMesh

# 6---7---8    a right mesh of 3 × 3 vertices
# | \ | / |
# 3---4---5
# | / | \ |
# 0---1---2
PLACES = [[x, y, x * y] for y in range(3) for x in range(3)]
TRIANGLES = [
    [0, 1, 4], [0, 4, 3], [1, 2, 4], [2, 5, 4], [4, 5, 8], [4, 8, 7], [4, 7, 6], [4, 6, 3],
]  # fmt: skip


def mesh_with(change_vertices=None, change_triangles=None):
    vertices, triangles = np.array(PLACES, float), np.array(TRIANGLES)
    if change_vertices is not None:
        vertices = change_vertices(vertices)
    if change_triangles is not None:
        triangles = change_triangles(triangles)
    return TriangleMesh(vertices, triangles)


def replaced(row, values):
    def change(array):
        array[row] = values
        return array

    return change


def added(*rows):
    return lambda array: np.vstack([array, rows])


def without(*rows):
    return lambda array: np.delete(array, rows, axis=0)


FAULTS = {
    "NaN": (
        mesh_with(replaced(4, [1, np.nan, 0])),
        ["vertex 4 has a coordinate that is not finite: (1, nan, 0)"],
    ),
    "infinite height": (
        mesh_with(replaced(4, [1, 1, np.inf])),
        ["vertex 4 has a coordinate that is not finite: (1, 1, inf)"],
    ),
    "vertex named twice": (
        mesh_with(None, replaced(2, [1, 1, 4])),
        ["triangle 2 (1, 1, 4) names a vertex twice"],
    ),
    "no area": (
        mesh_with(None, added([3, 5, 4])),
        ["triangle 8 (3, 5, 4) has no area seen from above"],
    ),
    "clockwise": (
        mesh_with(None, replaced(3, [5, 2, 4])),
        ["triangle 3 (5, 2, 4) is clockwise seen from above"],
    ),
    "vertex twice": (
        mesh_with(added([1, 1, 1]), replaced([4, 5], [[9, 5, 8], [9, 8, 7]])),
        ["vertices 4 and 9 share the place (1, 1)"],
    ),
    "wall": (
        mesh_with(added([1, 1, 7]), replaced([4, 5], [[9, 5, 8], [9, 8, 7]])),
        ["vertices 4 and 9 share the place (1, 1), at unlike heights"],
    ),
    "triangle twice": (
        mesh_with(None, added([4, 0, 1])),
        ["triangle 0 and triangle 8 (4, 0, 1) are the same"],
    ),
    "third triangle at an edge": (
        mesh_with(added([1.5, 0.2, 3]), added([4, 0, 9])),
        ["edge 0-4 belongs to 3 triangles: 0, 1, 8"],
    ),
    "fold": (
        TriangleMesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]], [[0, 1, 2], [0, 1, 3]]),
        ["triangles 0 and 1 overlap: both lie on the same side of edge 0-1"],
    ),
    "hanging vertex": (
        mesh_with(None, lambda t: np.vstack([t[:4], [[3, 5, 8], [8, 7, 3], [7, 6, 3]]])),
        ["vertex 4 hangs inside edge 3-5 of triangle 4, at (1, 1)"],
    ),
    "unused vertex": (mesh_with(added([9, 9, 9])), ["vertex 9 belongs to no triangle"]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_finds_each_fault_and_says_where(fault):
    mesh, expected = FAULTS[fault]
    with pytest.raises(validity.InvalidMesh) as raised:
        validity.check(mesh)
    assert str(raised.value) == expected[0]
    assert validity.complaints(mesh)[0].startswith(expected[0])


ALONE = ["infinite height", "clockwise", "fold", "hanging vertex", "unused vertex"]


@pytest.mark.parametrize("fault", ALONE)
def test_complains_of_nothing_else(fault):
    mesh, expected = FAULTS[fault]
    assert validity.complaints(mesh) == expected


def test_counts_faults_of_a_kind():
    mesh = mesh_with(added([9, 9, 9], [8, 9, 9]), replaced([0, 3], [[1, 0, 4], [5, 2, 4]]))
    assert validity.complaints(mesh) == [
        "triangle 0 (1, 0, 4) is clockwise seen from above (2 such)",
        "vertex 9 belongs to no triangle (2 such)",
    ]


def test_is_a_value_error():
    assert issubclass(validity.InvalidMesh, ValueError)


def test_passes_a_right_mesh_and_an_empty_one():
    validity.check(mesh_with())
    validity.check(TriangleMesh(np.empty((0, 3)), np.empty((0, 3), int)))
    assert validity.complaints(mesh_with()) == []


def test_passes_a_mesh_with_holes_and_parts_that_touch():
    validity.check(mesh_with(None, without(2, 6)))


def test_does_not_see_parts_that_overlap():
    vertices = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.1, 0.2, 0], [2.1, 0.2, 0], [0.1, 2.2, 0]]
    validity.check(TriangleMesh(vertices, [[0, 1, 2], [3, 4, 5]]))


@pytest.mark.parametrize("wrong", [None, (PLACES, TRIANGLES)])
def test_wants_a_mesh(wrong):
    with pytest.raises(TypeError, match="a TriangleMesh is wanted, got"):
        validity.check(wrong)


# --- hanging vertices in meshes of every kind ---------------------------------------------------


def with_one_triangle_split(mesh, triangle):
    """Bisect one triangle at the middle of its longest edge, and leave its neighbour alone."""
    a, b, c = mesh.triangles[triangle]
    middle = (mesh.vertices[a] + mesh.vertices[b]) / 2
    halves = [[c, a, mesh.n_vertices], [b, c, mesh.n_vertices]]
    triangles = np.vstack([np.delete(mesh.triangles, triangle, axis=0), halves])
    return TriangleMesh(np.vstack([mesh.vertices, middle]), triangles)


def has_a_neighbour_across_its_longest_edge(mesh, triangle):
    a, b, _ = mesh.triangles[triangle]
    return sum({a, b} <= set(other) for other in mesh.triangles.tolist()) == 2


@given(
    terrains.rasters(),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from(list(terrains.TRANSFORMS)),
    st.integers(0, 10**6),
)
def test_finds_a_vertex_that_hangs_in_a_bisected_mesh(heights, tolerance, transform, triangle):
    grid = rtin.Grid(heights, terrains.TRANSFORMS[transform])
    mesh = rtin.coarsen(grid, max_error=tolerance)
    validity.check(mesh)
    triangle %= mesh.n_triangles
    split = with_one_triangle_split(mesh, triangle)
    if has_a_neighbour_across_its_longest_edge(mesh, triangle):
        with pytest.raises(validity.InvalidMesh, match=f"vertex {mesh.n_vertices} hangs inside"):
            validity.check(split)
    else:
        validity.check(split)


@pytest.mark.parametrize("share", [0.03, 0.4, 0.5, 0.97])
def test_finds_a_vertex_anywhere_on_an_edge_of_any_length(share):
    for n_small in (1, 7, 300):  # a long edge beside many short ones
        small = [[i, 0, 0] for i in range(n_small + 1)] + [[i + 0.5, -1, 0] for i in range(n_small)]
        triangles = [[i, n_small + 1 + i, i + 1] for i in range(n_small)]
        ends = [[-0.5, 0, 0], [n_small + share, 0, 0], [3, 90, 0]]
        n = len(small)
        mesh = TriangleMesh(small + ends, [*triangles, [n, n + 1, n + 2]])
        assert validity.complaints(mesh)[0].startswith(f"vertex 0 hangs inside edge {n}-{n + 1} ")
        assert validity.complaints(mesh)[0].endswith(f"({n_small + 1} such)")


@given(st.integers(0, 2**32 - 1))
def test_finds_exactly_the_hanging_vertices_that_comparing_all_finds(seed):
    rng = np.random.default_rng(seed)
    angle, scale = rng.random() * 7, 10.0 ** rng.integers(-3, 4)
    turn = scale * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    places = np.unique(rng.integers(0, 12, (60, 2)), axis=0)
    triangles = [rng.permutation(len(places))[:3] for _ in range(15)]
    vertices = np.column_stack([places @ turn + rng.integers(0, 1000, 2), np.zeros(len(places))])
    mesh = TriangleMesh.from_triangles(vertices, np.array(triangles))
    found = [c for c in validity.complaints(mesh) if "hangs" in c]
    expected = hanging(places, mesh.triangles)
    assert bool(found) == bool(expected)
    if len(expected) > 1:
        assert found[0].endswith(f"({len(expected)} such)")


def hanging(places, triangles):
    """Ends of boundary edges that lie inside another one whose triangle is not theirs."""
    sides = {}
    for triangle in triangles.tolist():
        for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            sides.setdefault(frozenset((a, b)), []).append(triangle)
    lone = {edge: owners[0] for edge, owners in sides.items() if len(owners) == 1}
    candidates = {vertex for edge in lone for vertex in edge}
    found = set()
    for edge, owner in lone.items():
        a, b = (places[end] for end in edge)
        for vertex in candidates - set(owner):
            along, to_vertex = b - a, places[vertex] - a
            crossed = along[0] * to_vertex[1] - along[1] * to_vertex[0]
            if crossed == 0 and 0 < along @ to_vertex < along @ along:
                found.add(vertex)
    return found


def test_passes_a_large_mesh_with_many_voids():
    rng = np.random.default_rng(0)
    heights = rng.random((300, 300), np.float32)
    heights[rng.random(heights.shape) < 0.1] = np.nan
    validity.check(rtin.coarsen(rtin.Grid(heights), max_error=0.2))


# --- solids -------------------------------------------------------------------------------------


def test_a_terrain_is_not_closed_and_its_solid_is():
    from rtin.io.solid import close

    mesh = rtin.coarsen(rtin.Grid([[0.0, 1, 0], [1, 3, 1], [0, 1, 0]]), max_error=0)
    assert not validity.is_closed(mesh)
    assert validity.is_closed(close(mesh, 1.0))


def test_a_solid_that_lacks_a_side_is_not_closed():
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    sides = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    assert validity.is_closed(rtin.TriangleMesh(corners, sides))
    assert not validity.is_closed(rtin.TriangleMesh(corners, sides[:3]))
    assert not validity.is_closed(rtin.TriangleMesh(corners, [*sides, sides[0]]))
