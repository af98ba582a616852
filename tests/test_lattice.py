"""The kernels' integer geometry against triangles bisected by hand; all meshes of a lattice."""

import pytest

import naive
from rtin._kernels import lattice

SIZES = [2, 4, 8, 16]


def vertices(size):
    return [(row, col) for row in range(size + 1) for col in range(size + 1)]


def inside(size, *places):
    return [place for place in places if max(place) <= size and min(place) >= 0]


def triangles_at(size, apex):
    """Apex and both ends of each hypotenuse that the kernels name at an apex."""
    spacing = lattice.spacing_of(*apex)
    for direction in range(4 if spacing else 0):
        a_row, a_col, b_row, b_col = lattice.hypotenuse(*apex, spacing, direction)
        if len(inside(size, (a_row, a_col), (b_row, b_col))) == 2:
            yield direction, (apex, (a_row, a_col), (b_row, b_col))


@pytest.mark.parametrize("size", SIZES)
def test_names_exactly_the_triangles_of_repeated_bisection(size):
    named = [triangle for v in vertices(size) for _, triangle in triangles_at(size, v)]
    bisected = [(apex, frozenset((a, b))) for apex, a, b in naive.all_triangles(size)]
    assert sorted((apex, sorted((a, b))) for apex, a, b in named) == sorted(
        (apex, sorted(hypotenuse)) for apex, hypotenuse in bisected
    )


@pytest.mark.parametrize("size", SIZES)
def test_goes_round_every_triangle_in_the_same_sense(size):
    for vertex in vertices(size):
        for _, (apex, a, b) in triangles_at(size, vertex):
            assert naive.cross(apex, a, b) > 0  # rows down and columns right: seen from above


@pytest.mark.parametrize("size", SIZES)
def test_finds_the_midpoint_and_the_samples_of_every_triangle(size):
    for vertex in vertices(size):
        spacing = lattice.spacing_of(*vertex)
        for direction, triangle in triangles_at(size, vertex):
            assert lattice.is_unit(*vertex, spacing) == naive.is_unit(triangle)
            if not naive.is_unit(triangle):
                assert lattice.midpoint(*vertex, spacing, direction) == naive.midpoint(triangle)
            assert set(samples(vertex, spacing, direction)) == set(naive.weights(triangle))


def samples(apex, spacing, direction):
    first, last, left, left_step, right, right_step = lattice.row_spans(*apex, spacing, direction)
    for row in range(first, last + 1):
        distance = abs(row - apex[0])
        for col in range(left + left_step * distance, right + right_step * distance + 1):
            yield row, col


@pytest.mark.parametrize("size", SIZES)
def test_parents_are_the_apexes_of_the_triangles_that_a_vertex_bisects(size):
    for vertex in naive.bisections(size):
        p_row, p_col, q_row, q_col = lattice.apexes(*vertex, lattice.spacing_of(*vertex))
        found = inside(size, (p_row, p_col), (q_row, q_col))
        assert sorted(found) == sorted(naive.parents(vertex, size))


def test_tells_centre_vertices_and_their_diagonals():
    assert lattice.is_centre(3, 5, 1)
    assert not lattice.is_centre(3, 4, 1)
    assert not lattice.is_centre(2, 4, 2)
    assert lattice.runs_down_right(1, 1, 1)
    assert not lattice.runs_down_right(1, 3, 1)
    assert lattice.runs_down_right(3, 3, 1)
    assert not lattice.runs_down_right(2, 6, 2)


@pytest.mark.parametrize("row", [0, 1, 7, 2**20, 2**28])
@pytest.mark.parametrize("col", [0, 3, 2**21 + 1, 2**28])
@pytest.mark.parametrize("direction", range(5))
def test_unpacks_what_it_packed(row, col, direction):
    assert lattice.unpacked(lattice.packed(row, col, direction)) == (row, col, direction)


@pytest.mark.parametrize("size", [1, 2, 4])
def test_closed_sets_are_exactly_the_conforming_meshes(size):
    meshes = naive.conforming_meshes(size)
    vertex_sets = {frozenset(naive.corners_of(mesh)) for mesh in meshes}
    assert len(vertex_sets) == len(meshes)
    assert vertex_sets == set(naive.closed_sets(size))
    assert len(meshes) == {1: 1, 2: 17, 4: 5489}[size]
