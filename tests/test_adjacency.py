"""The twins of half-edges against a dictionary, and steps around a triangle."""

import numpy as np
import pytest
from hypothesis import given

import meshes
from rtin import validity
from rtin._adjacency import twins_of
from rtin._kernels import adjacency
from rtin.mesh import TriangleMesh


def twins_in_a_dictionary(mesh):
    half_edges = {}
    for triangle, corners in enumerate(mesh.triangles.tolist()):
        for side in range(3):
            half_edges[corners[side], corners[(side + 1) % 3]] = 3 * triangle + side
    return [half_edges.get((end, start), -1) for start, end in half_edges]


@given(meshes.any_mesh)
def test_twins_run_the_other_way_along_the_same_edge(mesh):
    twins = twins_of(mesh)
    assert twins.dtype == np.int32
    assert twins.tolist() == twins_in_a_dictionary(mesh)


@pytest.mark.parametrize("n_threads", ["1", "2", "7"])
def test_threads_change_no_twin(monkeypatch, n_threads):
    """Vertices enough for several bands."""
    monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
    rng = np.random.default_rng(1)
    for mesh in (meshes.uniform(64), meshes.delaunay(rng.random((2000, 2)), rng)):
        mesh = meshes.renumbered(mesh, rng)
        assert twins_of(mesh).tolist() == twins_in_a_dictionary(mesh)


def test_slivers_that_a_check_passes_have_twins_too():
    """Such as only the slow way to them is sure of."""
    thin = 1e-10
    vertices = [[0, 0, 0], [100, 0, 0], [50, 50 * thin, 0], [50, -50, 0]]
    mesh = TriangleMesh(vertices, [[0, 1, 2], [1, 0, 3]])
    validity.check(mesh)
    assert twins_of(mesh).tolist() == [3, -1, -1, 0, -1, -1]


def test_heights_may_be_as_large_as_float64_holds():
    mesh = TriangleMesh([[0, 0, 1.7e308], [1, 0, 1.7e308], [0, 1, 1.7e308]], [[0, 1, 2]])
    assert twins_of(mesh).tolist() == [-1, -1, -1]


@given(meshes.any_mesh)
def test_what_clearly_has_an_area_is_seen_to_have_one_by_a_check(mesh):
    """Flattened until none is left."""
    for _ in range(16):
        mesh = TriangleMesh(mesh.vertices * [1.0, 0.1, 1.0], mesh.triangles)
        if adjacency.all_turn_left(mesh.vertices, mesh.triangles, 0, mesh.n_triangles):
            assert not any("no area" in complaint for complaint in validity.complaints(mesh))
            continue
        return
    raise AssertionError("flat triangles are said to have an area")


def test_steps_around_a_triangle():
    assert [adjacency.next_side(side) for side in range(3)] == [1, 2, 0]
    assert [adjacency.next_edge(half_edge) for half_edge in range(9, 15)] == [10, 11, 9, 13, 14, 12]
    for half_edge in range(12):
        assert adjacency.previous_edge(adjacency.next_edge(half_edge)) == half_edge
