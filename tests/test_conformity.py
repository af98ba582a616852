"""`propagation` against a naive walk, and against what refining each triangle really splits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hand_meshes
import meshes
import naive
import rtin
from rtin.mesh import TriangleMesh
from rtin.studies.propagation import growing_strip

SQUARE = TriangleMesh.from_triangles(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
)


def refined_at_random(mesh, rng, n_times):
    for _ in range(n_times):
        mesh = rtin.refine(mesh, rng.integers(0, mesh.n_triangles, 1))
    return mesh


def assert_as_naive(mesh):
    triangles = mesh.triangles.tolist()
    walks = [naive.walks(triangles, number) for number in range(len(triangles))]
    m1, m2 = rtin.propagation(mesh)
    assert m1.tolist() == [len(set().union(*three)) for three in walks]
    assert m2.tolist() == [max(map(len, three)) for three in walks]


def n_split_beside(mesh, target, scheme):
    tagged = TriangleMesh(mesh.vertices, mesh.triangles, tags=np.arange(mesh.n_triangles))
    tags = rtin.refine(tagged, [target], scheme).tags
    return np.count_nonzero(np.bincount(tags) > 1) - 1


# --- against other ways to find it --------------------------------------------------------------


@given(meshes.any_mesh, meshes.seeds, st.integers(0, 8))
def test_is_the_walks_of_the_paper(mesh, seed, n_times):
    assert_as_naive(refined_at_random(mesh, np.random.default_rng(seed), n_times))


@given(meshes.any_mesh, meshes.seeds, st.sampled_from(["4T-LE", "4T-SS"]))
def test_m1_is_how_many_other_triangles_refining_splits(mesh, seed, scheme):
    mesh = refined_at_random(mesh, np.random.default_rng(seed), 3)
    m1, _ = rtin.propagation(mesh)
    assert m1.tolist() == [n_split_beside(mesh, t, scheme) for t in range(mesh.n_triangles)]


@given(meshes.any_mesh, meshes.seeds)
def test_any_edge_may_be_the_one_to_bisect(mesh, seed):
    """The longest edge it need not be; walks may then go in circles."""
    turns = np.random.default_rng(seed).integers(0, 3, (mesh.n_triangles, 1))
    triangles = np.take_along_axis(mesh.triangles, (np.arange(3) + turns) % 3, axis=1)
    assert_as_naive(TriangleMesh(mesh.vertices, triangles))


def test_a_walk_in_a_circle_comes_to_an_end():
    """A fan whose every triangle bisects a spoke, the one that it shares with the next."""
    n = 7
    turn = 2 * np.pi * np.arange(n) / n
    rim = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    first = np.arange(1, n + 1)
    later = first % n + 1
    mesh = TriangleMesh(np.vstack([[[0, 0, 0]], rim]), np.column_stack([later, 0 * first, first]))
    m1, m2 = rtin.propagation(mesh)
    assert (m1.tolist(), m2.tolist()) == ([n - 1] * n, [n - 1] * n)
    assert_as_naive(mesh)
    assert [n_split_beside(mesh, t, "4T-LE") for t in range(n)] == [n - 1] * n


def test_a_strip_of_ever_longer_edges_is_walked_to_its_end():
    mesh = growing_strip(300)
    m1, m2 = rtin.propagation(mesh)
    assert m1[0] == m2[0] == 299
    assert n_split_beside(mesh, 0, "4T-LE") == 299
    assert_as_naive(growing_strip(40))


# --- by hand ------------------------------------------------------------------------------------


def test_two_triangles_split_each_other():
    assert [values.tolist() for values in rtin.propagation(SQUARE)] == [[1, 1], [1, 1]]


def test_a_triangle_alone_splits_no_other():
    alone = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 2, 0]])
    assert [values.tolist() for values in rtin.propagation(alone)] == [[0], [0]]


def test_a_uniform_mesh_splits_five_more_away_from_the_border_and_three_along_it():
    mesh = meshes.uniform(8)
    m1, m2 = rtin.propagation(mesh)
    assert np.bincount(m1).tolist() == [0, 0, 0, 32, 0, 96]
    assert m2.tolist() == [2] * 128


@given(meshes.seeds, st.integers(0, 60))
def test_right_triangles_keep_the_bound_on_walks(seed, n_times):
    """M2 ≤ 2 log₂(longest edge / own longest edge) + 2: edges grow by √2 from one to the next."""
    mesh = refined_at_random(meshes.uniform(2), np.random.default_rng(seed), n_times)
    ends = mesh.vertices[mesh.triangles[:, :2], :2]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    _, m2 = rtin.propagation(mesh)
    assert (m2 <= 2 * np.log2(lengths.max() / lengths) + 2 + 1e-9).all()


# --- which triangles ----------------------------------------------------------------------------


@given(meshes.any_mesh, meshes.seeds)
def test_triangles_may_be_chosen_in_any_order_and_again(mesh, seed):
    rng = np.random.default_rng(seed)
    everywhere = rtin.propagation(mesh)
    numbers = rng.integers(0, mesh.n_triangles, 2 * mesh.n_triangles)
    mask = rng.random(mesh.n_triangles) < 0.5
    for chosen in [numbers, numbers.astype(np.uint8 if mesh.n_triangles < 256 else int), mask]:
        for some, values in zip(rtin.propagation(mesh, chosen), everywhere, strict=True):
            assert some.dtype == np.int32
            assert some.tolist() == values[chosen].tolist()


def test_no_triangles_have_no_propagation():
    for found in [
        rtin.propagation(SQUARE, []),
        rtin.propagation(SQUARE, [False, False]),
        rtin.propagation(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))),
    ]:
        assert (found.m1.shape, found.m2.shape) == ((0,), (0,))


def test_is_the_same_on_any_number_of_threads(monkeypatch):
    mesh = meshes.delaunay(np.random.default_rng(3).random((3000, 2)), np.random.default_rng(4))
    found = []
    for n_threads in ("1", "2", "5"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        found.append([values.tobytes() for values in rtin.propagation(mesh)])
    assert found[0] == found[1] == found[2]


def test_changes_nothing():
    mesh = meshes.uniform(4)
    before = mesh.vertices.tobytes(), mesh.triangles.tobytes()
    chosen = np.array([5, 3, 3])
    rtin.propagation(mesh, chosen)
    assert (mesh.vertices.tobytes(), mesh.triangles.tobytes()) == before
    assert chosen.tolist() == [5, 3, 3]


# --- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("triangles", "error", "wanted"),
    [
        ([2], IndexError, "there are 2 triangles, numbered from 0; got 2"),
        ([-1], IndexError, "got -1"),
        ([0.0], TypeError, "float64"),
        (["0"], TypeError, "boolean for each"),
        ([True], ValueError, "each of 2, got 1"),
        ([[0, 1]], ValueError, "one dimension"),
    ],
)
def test_refuses_triangles_that_are_not_as_they_should_be(triangles, error, wanted):
    with pytest.raises(error, match=wanted):
        rtin.propagation(SQUARE, triangles)


def test_refuses_a_mesh_with_a_hanging_node():
    corners = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]]
    hanging = TriangleMesh(corners, [[2, 3, 0], [1, 4, 0], [2, 4, 1]])
    with pytest.raises(rtin.validity.InvalidMesh):
        rtin.propagation(hanging)


def test_refuses_what_is_no_mesh():
    with pytest.raises(TypeError, match="TriangleMesh"):
        rtin.propagation(SQUARE.triangles)


def test_walks_end_at_a_hole():
    assert_as_naive(TriangleMesh.from_triangles(*_arrays(hand_meshes.with_hole())))
    assert_as_naive(TriangleMesh.from_triangles(*_arrays(hand_meshes.touching_at_a_point())))


def _arrays(mesh):
    return mesh.vertices, mesh.triangles
