"""The mesh's door, and foreign triangles brought into order."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive
import rtin
import terrains
from rtin import validity
from rtin.mesh import TriangleMesh

SQUARE = [[0, 0, 1], [2, 0, 2], [2, 1, 3], [0, 1, 4]]


def test_takes_arrays_as_they_are():
    vertices, triangles = np.array(SQUARE, float), np.array([[0, 2, 1]], np.int32)
    mesh = TriangleMesh(vertices, triangles)
    assert np.shares_memory(mesh.vertices, vertices)
    assert np.shares_memory(mesh.triangles, triangles)
    assert vertices.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0, 0] = 1.0


def test_casts_to_its_own_types():
    mesh = TriangleMesh(SQUARE, np.array([[0, 1, 2]], np.uint64))
    assert (mesh.vertices.dtype, mesh.triangles.dtype) == (np.float64, np.int32)


def test_replace_gives_a_changed_and_checked_mesh():
    mesh = TriangleMesh(SQUARE, [[0, 1, 2]], "EPSG:2056")
    moved = dataclasses.replace(mesh, vertices=mesh.vertices + 1.0)
    assert moved.bounds.tolist() == [[1, 1, 2], [3, 2, 5]]
    assert (moved.crs, moved.triangles.tolist()) == (mesh.crs, [[0, 1, 2]])
    with pytest.raises(ValueError, match="must name vertices 0 to 3"):
        dataclasses.replace(mesh, triangles=[[0, 1, 4]])


def test_counts_and_bounds():
    mesh = TriangleMesh(SQUARE, [[0, 1, 2], [2, 3, 0]], "EPSG:2056")
    assert (mesh.n_vertices, mesh.n_triangles) == (4, 2)
    assert mesh.bounds.tolist() == [[0, 0, 1], [2, 1, 4]]
    assert mesh.signed_areas().tolist() == [1, 1]
    assert repr(mesh) == "<TriangleMesh 4 vertices, 2 triangles, EPSG:2056>"


def test_lists_each_edge_once_with_the_smaller_number_first():
    mesh = TriangleMesh(SQUARE, [[2, 0, 1], [0, 2, 3]])
    assert mesh.edges().tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    assert TriangleMesh(SQUARE, np.empty((0, 3), int)).edges().shape == (0, 2)
    assert TriangleMesh(np.empty((0, 3)), np.empty((0, 3), int)).edges().shape == (0, 2)


def test_a_mesh_without_vertices_has_no_bounds():
    with pytest.raises(ValueError, match="a mesh with vertices is wanted for its bounds"):
        _ = TriangleMesh(np.empty((0, 3)), np.empty((0, 3), int)).bounds


def test_areas_are_exact_far_from_the_origin():
    vertices = np.array(SQUARE) + np.array([5e6, 5e6, 0])
    assert TriangleMesh(vertices, [[0, 1, 2], [0, 2, 1]]).signed_areas().tolist() == [1, -1]


def test_from_triangles_keeps_the_order_of_vertices_and_triangles():
    mesh = TriangleMesh.from_triangles(SQUARE, [[3, 2, 0], [1, 2, 0]])
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    assert mesh.triangles.tolist() == [[0, 2, 3], [2, 0, 1]]


@given(st.integers(0, 2**32 - 1))
def test_from_triangles_puts_the_longest_edge_first_and_turns_counter_clockwise(seed):
    rng = np.random.default_rng(seed)
    vertices = rng.random((12, 3)) * [100, 100, 1e4]
    triangles = np.array([rng.permutation(12)[:3] for _ in range(20)])
    mesh = TriangleMesh.from_triangles(vertices, triangles)
    assert (mesh.signed_areas() > 0).all()
    assert (np.sort(mesh.triangles, axis=1) == np.sort(triangles, axis=1)).all()
    for a, b, c in mesh.vertices[mesh.triangles, :2]:
        longest = np.linalg.norm(b - a)
        assert longest >= np.linalg.norm(c - b)
        assert longest >= np.linalg.norm(a - c)


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.0, 2.2])
def test_equal_edges_are_told_apart_the_same_way_from_both_sides(turn):
    """On an equilateral lattice, numbered at random, all triangles bisect parallel edges."""
    row, col = np.divmod(np.arange(36), 6)
    x, y = col + 0.5 * row, np.sqrt(0.75) * row
    points = np.c_[np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, x]
    cells = np.array([n for n in range(30) if n % 6 < 5])
    corners = np.r_[np.c_[cells, cells + 1, cells + 6], np.c_[cells + 1, cells + 7, cells + 6]]
    rng = np.random.default_rng(3)
    mesh = TriangleMesh.from_triangles(points + 4e6, rng.permuted(corners, axis=1))
    directions = np.diff(mesh.vertices[mesh.triangles[:, :2], :2], axis=1)[:, 0]
    along, across = directions[0], np.array([-directions[0, 1], directions[0, 0]])
    np.testing.assert_allclose(directions @ across, 0.0, atol=1e-8)
    np.testing.assert_allclose(np.abs(directions @ along), 1.0)


def test_of_two_equal_edges_the_choice_does_not_depend_on_the_numbering():
    acute = [[0, 0, 0], [2, 0, 0], [1, 2, 0]]
    wanted = TriangleMesh.from_triangles(acute, [[0, 1, 2]]).triangles.tolist()
    assert wanted == [[2, 0, 1]]  # the one that goes north-east, close to the fixed direction
    for corners in ([1, 2, 0], [2, 0, 1], [2, 1, 0], [0, 2, 1]):
        assert TriangleMesh.from_triangles(acute, [corners]).triangles.tolist() == wanted


@given(terrains.rasters(), terrains.tolerances, st.integers(0, 2**32 - 1))
def test_from_triangles_restores_a_shuffled_coarsened_mesh(heights, tolerance, seed):
    grid = rtin.Grid(heights)
    mesh = rtin.coarsen(grid, max_error=tolerance)
    rng = np.random.default_rng(seed)
    shuffled = rng.permuted(mesh.triangles, axis=1)
    restored = TriangleMesh.from_triangles(mesh.vertices, shuffled)
    np.testing.assert_array_equal(restored.triangles, mesh.triangles)
    assert naive.triangles_of(restored, grid) == naive.triangles_of(mesh, grid)
    validity.check(restored)


WRONG = {
    "flat vertices": (([1.0, 2.0, 3.0], [[0, 0, 0]]), ValueError, r"\(n, 3\), got \(3,\)"),
    "plane vertices": ((np.zeros((4, 2)), [[0, 1, 2]]), ValueError, r"\(n, 3\), got \(4, 2\)"),
    "flat triangles": ((SQUARE, [0, 1, 2]), ValueError, r"\(m, 3\), got \(3,\)"),
    "quads": ((SQUARE, [[0, 1, 2, 3]]), ValueError, r"\(m, 3\), got \(1, 4\)"),
    "fractions": ((SQUARE, [[0.0, 1.0, 2.0]]), TypeError, "whole numbers, got .* float64"),
    "booleans": ((SQUARE, [[True, False, True]]), TypeError, "whole numbers, got .* bool"),
    "too high": ((SQUARE, [[0, 1, 4]]), ValueError, "vertices 0 to 3, got numbers from 0 to 4"),
    "negative": ((SQUARE, [[0, 1, -1]]), ValueError, "vertices 0 to 3, got numbers from -1 to 1"),
    "crs": ((SQUARE, [[0, 1, 2]], "EPSG:0"), ValueError, "crs must be one that pyproj knows"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_says_in_one_line_what_was_wanted_and_what_came(wrong):
    arguments, error, message = WRONG[wrong]
    for make in (TriangleMesh, TriangleMesh.from_triangles):
        with pytest.raises(error, match=message) as raised:
            make(*arguments)
        assert "\n" not in str(raised.value)


def test_may_be_empty():
    mesh = TriangleMesh(np.empty((0, 3)), np.empty((0, 3), int))
    assert (mesh.n_vertices, mesh.n_triangles) == (0, 0)


def test_tags_go_with_their_triangles():
    tags = np.array([7, -3], np.int64)
    mesh = TriangleMesh.from_triangles(SQUARE, [[0, 3, 2], [0, 1, 2]], tags=tags)
    assert (mesh.tags.tolist(), mesh.tags.dtype) == ([7, -3], np.int32)
    assert TriangleMesh(SQUARE, [[0, 1, 2]]).tags is None
    with pytest.raises(ValueError, match="read-only"):
        mesh.tags[0] = 1


@pytest.mark.parametrize(
    ("tags", "error", "message"),
    [
        ([1], ValueError, r"tags must have shape \(2,\), got \(1,\)"),
        ([1.0, 2.0], TypeError, "tags must be whole numbers, got an array of float64"),
        ([1, 2**31], ValueError, "tags must fit in 32 bits, got 1 to 2147483648"),
    ],
)
def test_refuses_wrong_tags(tags, error, message):
    with pytest.raises(error, match=message):
        TriangleMesh(SQUARE, [[0, 1, 2], [2, 3, 0]], tags=tags)


@pytest.mark.parametrize("tags", [None, [7]])
def test_arrays_stay_as_they_are_in_copies(tags):
    mesh = rtin.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 2, 0]], tags=tags)
    for other in (copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh))):
        arrays = [other.vertices, other.triangles] + ([] if tags is None else [other.tags])
        assert not any(array.flags.writeable for array in arrays)
