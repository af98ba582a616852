"""`AdaptiveMesh` against its naive twin, the laws of going back and forth, and what it promises."""

import copy
import doctest
import importlib
import re
import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import meshes
import naive
import rtin
import terrains
from rtin import AdaptiveMesh, TriangleMesh, validity
from rtin._kernels import adaptive as kernels

SCHEMES = meshes.SCHEMES
SQUARE = TriangleMesh([[0, 0, 0], [2, 0, 1], [2, 2, 4], [0, 2, 9]], [[0, 2, 3], [2, 0, 1]])
# Of (a, b, c) = (0, 1, 2); all sides differ.
ALONE = TriangleMesh([[0, 0, 0], [8, 0, 3], [3, 4, 1]], [[0, 1, 2]])


def places_of(mesh):
    """Each triangle as its three places, the edge to bisect first in front."""
    places = list(map(tuple, mesh.vertices.tolist()))
    return [tuple(places[corner] for corner in corners) for corners in mesh.triangles.tolist()]


def bytes_of(adaptive):
    """All that one can see of it."""
    mesh = adaptive.mesh
    arrays = [mesh.vertices, mesh.triangles, adaptive.roots, adaptive.levels]
    tags = [] if mesh.tags is None else [mesh.tags]
    return [array.tobytes() for array in (*arrays, adaptive.midpoint_parents, *tags)]


def tagged(mesh):
    return TriangleMesh(mesh.vertices, mesh.triangles, mesh.crs, np.arange(mesh.n_triangles) + 7)


class Step:
    """One random change: what was before, what was asked for, and what came back."""

    def __init__(self, adaptive, rng, most=400):
        self.before, self.roots = adaptive.mesh, adaptive.roots
        self.places = places_of(self.before)
        wants_less = adaptive.n_triangles > most or rng.random() < 0.5
        self.scheme = None if wants_less else str(rng.choice(SCHEMES))
        if self.scheme:
            self.targets = meshes.targets_of(self.before, rng)
            if adaptive.n_triangles > most // 4:
                self.targets = self.targets[:5]
            self.returned = adaptive.refine(self.targets, self.scheme)
        else:
            self.targets = some_to_coarsen(self.before, rng)
            self.returned = adaptive.coarsen(self.targets)
        self.after = adaptive.mesh


def some_to_coarsen(mesh, rng):
    """All triangles, most of them, those around some vertices, or those in a part of the plane."""
    kind = rng.integers(4)
    if kind == 0:
        return np.arange(mesh.n_triangles)
    if kind == 1:
        return np.flatnonzero(rng.random(mesh.n_triangles) < 0.9)
    if kind == 2:
        vertices = rng.integers(0, mesh.n_vertices, 1 + mesh.n_vertices // 3)
        return np.flatnonzero(np.isin(mesh.triangles, vertices).any(axis=1))
    x, y = mesh.vertices[mesh.triangles, :2].mean(axis=1).T
    along = rng.normal() * (x - x.mean()) + rng.normal() * (y - y.mean())
    return np.flatnonzero(along <= np.quantile(along, rng.random()))


def walk(adaptive, seed, n_steps):
    rng = np.random.default_rng(seed)
    for _ in range(n_steps):
        yield Step(adaptive, rng)


def walked(mesh, seed, n_steps, **options):
    """An AdaptiveMesh after some random changes."""
    adaptive = AdaptiveMesh(mesh, **options)
    for _ in walk(adaptive, seed, n_steps):
        pass
    return adaptive


def everything(adaptive):
    return np.arange(adaptive.n_triangles)


# --- against the naive twin ---------------------------------------------------------------------


def assert_is_as_written_down(mesh, seed, n_steps):
    adaptive, history = AdaptiveMesh(mesh), naive.History(places_of(mesh))
    for step in walk(adaptive, seed, n_steps):
        targets = [step.places[target] for target in step.targets]
        if step.scheme:
            history.refine(targets, step.scheme)
        else:
            history.coarsen(targets)
        assert set(places_of(step.after)) == history.triangles()
    return adaptive


@given(meshes.any_mesh, meshes.seeds)
def test_makes_and_unmakes_the_triangles_that_the_docstrings_say(mesh, seed):
    assert_is_as_written_down(mesh, seed, 6)


@settings(max_examples=15)
@given(meshes.tins(generic=True), meshes.seeds)
def test_keeps_doing_so_over_many_steps(mesh, seed):
    assert_is_as_written_down(mesh, seed, 25)


def around(mesh, place):
    """Numbers of the triangles around a place in the xy plane."""
    (vertex,) = np.flatnonzero((mesh.vertices[:, :2] == place).all(axis=1))
    return np.flatnonzero((mesh.triangles == vertex).any(axis=1))


M, P, Q = (4.0, 0.0), (5.5, 2.0), (1.5, 2.0)  # the middles of the sides of ALONE
SIDES = {M: 0, P: 1, Q: 2}


@pytest.mark.parametrize("scheme", ["4T-LE", "4T-SS"])
@pytest.mark.parametrize("gone", [[P], [Q], [P, Q], [Q, P], [P, Q, M], [Q, P, M]], ids=len)
def test_without_a_midpoint_it_is_what_refine_makes_without_that_mark(scheme, gone):
    adaptive = AdaptiveMesh(ALONE)
    adaptive.refine([0], scheme)
    for place in gone:
        adaptive.coarsen(around(adaptive.mesh, place))
    corners = places_of(ALONE)[0]
    edges = naive.edges_of(corners)
    marked = {edges[side] for place, side in SIDES.items() if place not in gone}
    assert set(places_of(adaptive.mesh)) == set(naive.pieces(corners, marked, "4T-LE"))


def test_the_midpoint_of_the_longest_edge_stays_where_the_others_stay():
    adaptive = AdaptiveMesh(ALONE)
    adaptive.refine([0], "4T-SS")
    before = bytes_of(adaptive)
    star = around(adaptive.mesh, M)
    assert len(star) == 3
    assert adaptive.coarsen(star).size == 0
    assert bytes_of(adaptive) == before


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_vertex_stays_where_one_triangle_around_it_is_no_target(scheme):
    adaptive = AdaptiveMesh(SQUARE)
    adaptive.refine([0, 1], scheme)
    refined = adaptive.mesh
    for vertex in np.flatnonzero(adaptive.midpoint_parents[:, 0] >= 0):
        for left_out in np.flatnonzero((refined.triangles == vertex).any(axis=1)):
            adaptive = AdaptiveMesh(SQUARE)
            adaptive.refine([0, 1], scheme)
            adaptive.coarsen(np.setdiff1d(everything(adaptive), left_out))
            places = adaptive.mesh.vertices.tolist()
            assert refined.vertices[vertex].tolist() in places


def test_one_call_takes_back_one_call_at_a_place():
    adaptive = AdaptiveMesh(SQUARE)
    counts = [adaptive.n_triangles]
    for scheme in ["4T-LE", "bisection", "4T-SS", "bisection", "4T-LE"]:
        adaptive.refine(everything(adaptive), scheme)
        counts.append(adaptive.n_triangles)
    for n_triangles in counts[-2::-1]:
        adaptive.coarsen(everything(adaptive))
        assert adaptive.n_triangles == n_triangles
    assert adaptive.coarsen(everything(adaptive)).size == 0


def test_one_call_takes_back_the_latest_call_at_each_place():
    adaptive = AdaptiveMesh(meshes.joined(ALONE, SQUARE))
    adaptive.refine([0])
    adaptive.refine(np.flatnonzero(adaptive.roots > 0), "4T-SS")
    adaptive.coarsen(everything(adaptive))
    assert adaptive.n_triangles == 3


def test_a_vertex_that_is_merged_from_both_sides_may_be_of_different_schemes():
    """4T-SS on one side of an edge, bisection by propagation on the other."""
    for scheme in SCHEMES:
        adaptive = AdaptiveMesh(SQUARE)
        adaptive.refine([1], "bisection")
        beside = adaptive.refine([0], scheme)
        history = naive.History(places_of(SQUARE))
        history.refine([places_of(SQUARE)[1]], "bisection")
        history.refine([history.leaves()[0].corners], scheme)
        assert set(places_of(adaptive.mesh)) == history.triangles()
        history.coarsen([places_of(adaptive.mesh)[t] for t in beside])
        adaptive.coarsen(beside)
        assert set(places_of(adaptive.mesh)) == history.triangles()


# --- laws of going back and forth ---------------------------------------------------------------


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_refines_as_refine_does(mesh, scheme, seed):
    adaptive = walked(mesh, seed, 2)
    for n_steps in range(2):
        before = adaptive.mesh
        targets = meshes.targets_of(before, np.random.default_rng(seed + n_steps))
        new = adaptive.refine(targets, scheme)
        refined = rtin.refine(before, targets, scheme)
        assert sorted(places_of(adaptive.mesh)) == sorted(places_of(refined))
        assert len(new) == refined.n_triangles - len(
            set(places_of(before)) & set(places_of(refined))
        )


@given(meshes.any_mesh, st.lists(meshes.schemes, min_size=1, max_size=3), meshes.seeds)
def test_coarsening_what_is_new_restores_every_byte(mesh, schemes, seed):
    rng = np.random.default_rng(seed)
    adaptive = walked(tagged(mesh), seed, int(rng.integers(5)))
    states = []
    for scheme in schemes:
        before = bytes_of(adaptive)
        states.append((before, adaptive.refine(meshes.targets_of(adaptive.mesh, rng), scheme)))
    for before, new in reversed(states):
        adaptive.coarsen(new)
        assert bytes_of(adaptive) == before


@given(meshes.any_mesh, meshes.seeds)
def test_coarsening_all_again_and_again_comes_back_to_the_first_mesh(mesh, seed):
    """To the byte, and so in its order, whatever happened on the way."""
    first = bytes_of(AdaptiveMesh(tagged(mesh)))
    adaptive = walked(tagged(mesh), seed, 8)
    n_calls = 0
    while adaptive.coarsen(everything(adaptive)).size:
        n_calls += 1
    assert n_calls <= 8
    assert bytes_of(adaptive) == first


@given(meshes.any_mesh, meshes.seeds)
def test_restores_triangles_that_are_not_bisected_along_their_longest_edge_first(mesh, seed):
    rng = np.random.default_rng(seed)
    turns = rng.integers(0, 3, mesh.n_triangles)[:, None] + np.arange(3)
    mesh = TriangleMesh(mesh.vertices, np.take_along_axis(mesh.triangles, turns % 3, axis=1))
    adaptive = walked(mesh, seed, 3)
    before = bytes_of(adaptive)
    adaptive.coarsen(adaptive.refine(meshes.targets_of(adaptive.mesh, rng), SCHEMES[seed % 3]))
    assert bytes_of(adaptive) == before
    while adaptive.coarsen(everything(adaptive)).size:
        pass
    assert bytes_of(adaptive) == bytes_of(AdaptiveMesh(mesh))


@given(meshes.any_mesh, meshes.seeds)
def test_is_a_right_mesh_after_every_step(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    area = mesh.signed_areas()
    for step in walk(adaptive, seed, 6):
        now, levels, roots = step.after, adaptive.levels, adaptive.roots
        assert meshes.is_right(now)
        assert (now.n_vertices, now.n_triangles) == (adaptive.n_vertices, adaptive.n_triangles)
        np.testing.assert_allclose(now.signed_areas(), area[roots] * 0.5**levels, rtol=1e-6)
        np.testing.assert_allclose(np.bincount(roots, now.signed_areas()), area, rtol=1e-6)
        assert now.vertices[: mesh.n_vertices].tobytes() == mesh.vertices.tobytes()
        assert levels.dtype == np.int32
        assert roots.dtype == np.int32


@given(meshes.any_mesh, meshes.seeds)
def test_knows_whose_midpoint_each_vertex_is(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    for step in walk(adaptive, seed, 6):
        parents, vertices = adaptive.midpoint_parents, step.after.vertices
        assert parents.shape == (step.after.n_vertices, 2)
        assert parents.dtype == np.int32
        assert (parents[: mesh.n_vertices] == -1).all()
        ends = vertices[parents[mesh.n_vertices :]]
        assert (parents[mesh.n_vertices :] >= 0).all()
        np.testing.assert_array_equal(vertices[mesh.n_vertices :], (ends[:, 0] + ends[:, 1]) / 2)


@given(meshes.any_mesh, meshes.seeds)
def test_returns_just_the_triangles_that_are_new(mesh, seed):
    for step in walk(AdaptiveMesh(mesh), seed, 8):
        old = set(step.places)
        new = [n for n, triangle in enumerate(places_of(step.after)) if triangle not in old]
        assert step.returned.dtype == np.int32
        assert sorted(step.returned.tolist()) == new


def test_returns_no_triangle_that_only_moved():
    """The last triangles move into what merging in the middle of the list has freed."""
    for scheme in SCHEMES:
        adaptive = AdaptiveMesh(meshes.uniform(4))
        first = adaptive.refine([0], scheme)
        second = adaptive.refine([20], scheme)
        before = set(places_of(adaptive.mesh))
        merged = adaptive.coarsen(np.setdiff1d(first, second))
        now = places_of(adaptive.mesh)
        assert merged.tolist() == [n for n, t in enumerate(now) if t not in before]


@given(meshes.any_mesh, meshes.seeds)
def test_vertices_keep_their_order(mesh, seed):
    for step in walk(AdaptiveMesh(mesh), seed, 8):
        old, new = (list(map(tuple, m.vertices.tolist())) for m in (step.before, step.after))
        assert [v for v in old if v in set(new)] == [v for v in new if v in set(old)]


@given(meshes.any_mesh, meshes.seeds)
def test_triangles_keep_their_numbers_as_the_docstring_says(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    for step in walk(adaptive, seed, 8):
        old, new = step.places, places_of(step.after)
        number = {triangle: n for n, triangle in enumerate(new)}
        n_now = len(new)
        for n, triangle in enumerate(old):
            if triangle not in number:
                continue
            if step.scheme or n < n_now:
                assert number[triangle] == n
            else:
                assert new[number[triangle]] not in old[:n_now]
        if step.scheme:
            assert_first_children_stay(step, new)


def assert_first_children_stay(step, new):
    refined = rtin.refine(tagged(step.before), step.targets, step.scheme)
    parents, children = refined.tags - 7, places_of(refined)
    _, first = np.unique(parents, return_index=True)
    others = np.setdiff1d(np.arange(refined.n_triangles), first)
    assert new == [children[child] for child in [*first, *others]]


@pytest.mark.parametrize(
    ("scheme", "gone", "numbers"),
    [
        ("4T-LE", [], {"mcq": 0, "amq": 3, "mbp": 4, "cmp": 5}),
        ("4T-SS", [], {"qpc": 0, "amq": 3, "mbp": 4, "pqm": 5}),
        ("4T-LE", [P], {"mcq": 0, "amq": 3, "bcm": 4}),
        ("4T-SS", [P], {"mcq": 0, "amq": 3, "bcm": 4}),
        ("4T-LE", [Q], {"cam": 0, "mbp": 4, "cmp": 5}),
        ("4T-SS", [Q], {"cam": 0, "mbp": 4, "cmp": 5}),
        ("4T-LE", [P, Q], {"cam": 0, "bcm": 4}),
        ("4T-SS", [P, Q], {"cam": 0, "bcm": 4}),
        ("4T-SS", [Q, P], {"cam": 0, "bcm": 4}),
        ("4T-SS", [P, Q, M], {"abc": 0}),
    ],
)
def test_a_merged_triangle_takes_the_number_of_its_first_child(scheme, gone, numbers):
    """In the letters of the docstring of refine; others have been appended since."""
    adaptive = AdaptiveMesh(meshes.joined(ALONE, SQUARE))
    letters = dict(zip("abcmpq", [*ALONE.vertices[:, :2].tolist(), M, P, Q], strict=True))
    adaptive.refine([0], scheme)
    adaptive.refine([1, 2])
    for place in gone:
        adaptive.coarsen(around(adaptive.mesh, place))
    corners = adaptive.mesh.vertices[adaptive.mesh.triangles, :2].tolist()
    for triangle, number in numbers.items():
        assert {tuple(place) for place in corners[number]} == {tuple(letters[x]) for x in triangle}


@given(meshes.any_mesh, meshes.seeds)
def test_parents_hold_their_children_and_merged_ones_hold_theirs(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    assert adaptive.parents.tolist() == list(range(mesh.n_triangles))
    for step in walk(adaptive, seed, 6):
        parents, now = adaptive.parents, places_of(step.after)
        assert parents.dtype == np.int32
        assert (step.roots[parents] == adaptive.roots).all()
        for n, parent in enumerate(parents.tolist()):
            if now[n] in set(step.places):
                assert step.places[parent] == now[n]
            share = overlap(now[n], step.places[parent])
            area = min(area_of(now[n]), area_of(step.places[parent]))
            # Two quarters of 4T-SS lie across those that come back, and share a half with each.
            assert share > 0.99 * area or (not step.scheme and share > 0.49 * area)
            assert parent == n or parent >= len(now) or step.scheme


@given(meshes.any_mesh, meshes.seeds)
def test_no_targets_change_nothing(mesh, seed):
    adaptive = walked(tagged(mesh), seed, 3)
    before = bytes_of(adaptive)
    for change in [adaptive.refine, adaptive.coarsen] * 2:
        for targets in [[], np.zeros(adaptive.n_triangles, bool), np.empty(0, int)]:
            returned = change(targets)
            assert returned.dtype == np.int32
            assert returned.shape == (0,)
            assert bytes_of(adaptive) == before
            assert adaptive.parents.tolist() == list(range(adaptive.n_triangles))
            for on, n in [("vertices", adaptive.n_vertices), ("triangles", adaptive.n_triangles)]:
                values = np.arange(n) / 3
                assert adaptive.transfer(values, on).tolist() == values.tolist()


@given(meshes.any_mesh, meshes.seeds)
def test_ways_to_name_targets_agree(mesh, seed):
    one, other = AdaptiveMesh(mesh), AdaptiveMesh(mesh)
    rng = np.random.default_rng(seed)
    for step in walk(one, seed, 4):
        mask = np.zeros(step.before.n_triangles, bool)
        mask[step.targets] = True
        named = mask if rng.random() < 0.5 else rng.permutation(np.tile(step.targets, 2)).tolist()
        change = (other.refine, (step.scheme,)) if step.scheme else (other.coarsen, ())
        assert change[0](named, *change[1]).tobytes() == step.returned.tobytes()
        assert bytes_of(one) == bytes_of(other)


@given(meshes.any_mesh, meshes.seeds)
def test_goes_on_from_a_state_as_from_a_new_mesh(mesh, seed):
    """Neighbours are right everywhere: refining all, or any one, makes what refine makes."""
    adaptive = walked(mesh, seed, 8)
    now = adaptive.mesh
    for targets, scheme in [([0], "4T-LE"), ([now.n_triangles - 1], "4T-SS")]:
        new = adaptive.refine(targets, scheme)
        assert sorted(places_of(adaptive.mesh)) == sorted(
            places_of(rtin.refine(now, targets, scheme))
        )
        adaptive.coarsen(new)
    adaptive.refine(everything(adaptive), "bisection")
    refined = rtin.refine(now, np.arange(now.n_triangles), "bisection")
    assert sorted(places_of(adaptive.mesh)) == sorted(places_of(refined))


# --- values -------------------------------------------------------------------------------------


def area_of(polygon):
    (east, north), *_ = polygon = [place[:2] for place in polygon]
    polygon = [(x - east, y - north) for x, y in polygon]
    return 0.5 * sum(p[0] * q[1] - p[1] * q[0] for p, q in pairwise([*polygon, polygon[0]]))


def overlap(one, other):
    """Area that two triangles share: one clipped along the sides of the other."""
    origin = other[0]
    one = [(x - origin[0], y - origin[1]) for x, y, *_ in one]
    other = [(x - origin[0], y - origin[1]) for x, y, *_ in other]
    for start, end in pairwise([*other, other[0]]):

        def depth(p, start=start, end=end):
            along, to = (end[0] - start[0], end[1] - start[1]), (p[0] - start[0], p[1] - start[1])
            return along[0] * to[1] - along[1] * to[0]

        inside = []
        for p, q in pairwise([*one, *one[:1]]):
            at_p, at_q = depth(p), depth(q)
            if at_p >= 0:
                inside.append(p)
            if at_p * at_q < 0:
                t = at_p / (at_p - at_q)
                inside.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
        one = inside
    return area_of(one) if one else 0.0


@given(meshes.any_mesh, meshes.seeds)
def test_carries_functions_that_are_linear_on_each_triangle_up_and_injects_them_down(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    rng = np.random.default_rng(seed)
    for step in walk(adaptive, seed, 6):
        values = rng.normal(size=step.before.n_vertices)
        carried = adaptive.transfer(values)
        at = dict(zip(map(tuple, step.before.vertices.tolist()), values, strict=True))
        places = list(map(tuple, step.after.vertices.tolist()))
        for place, value, ends in zip(places, carried, adaptive.midpoint_parents, strict=True):
            wanted = at[place] if place in at else np.mean([at[places[end]] for end in ends])
            assert value == wanted


@given(meshes.any_mesh, meshes.seeds)
def test_a_plane_stays_a_plane_over_many_steps(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    values = mesh.vertices @ [[2.0, 1.0], [-3.0, 0.0], [0.5, 0.0]] + [7.0, 0.0]
    for step in walk(adaptive, seed, 12):
        values = adaptive.transfer(values)
        wanted = step.after.vertices @ [[2.0, 1.0], [-3.0, 0.0], [0.5, 0.0]] + [7.0, 0.0]
        np.testing.assert_allclose(values, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())


@given(meshes.any_mesh, meshes.seeds)
def test_values_of_triangles_are_means_over_what_they_lie_in_or_hold(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    rng = np.random.default_rng(seed)
    for step in walk(adaptive, seed, 4):
        values = rng.normal(size=step.before.n_triangles)
        carried = adaptive.transfer(values, "triangles")
        where = {triangle: n for n, triangle in enumerate(step.places)}
        for n, triangle in enumerate(places_of(step.after)):
            if triangle in where:
                assert carried[n] == values[where[triangle]]
                continue
            near = np.flatnonzero(step.roots == adaptive.roots[n])
            shares = np.array([overlap(triangle, step.places[t]) for t in near])
            wanted = shares @ values[near] / shares.sum()
            assert carried[n] == pytest.approx(wanted, rel=1e-6, abs=1e-6)


@given(meshes.any_mesh, meshes.seeds)
def test_keeps_the_sum_of_value_times_area_over_many_steps(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    values = np.random.default_rng(seed).random((mesh.n_triangles, 2))
    total = mesh.signed_areas() @ values
    for step in walk(adaptive, seed, 12):
        values = adaptive.transfer(values, "triangles")
        np.testing.assert_allclose(step.after.signed_areas() @ values, total, rtol=1e-7)


@given(meshes.any_mesh, meshes.seeds)
def test_the_matrices_do_what_transfer_does(mesh, seed):
    adaptive = AdaptiveMesh(mesh)
    rng = np.random.default_rng(seed)
    for step in walk(adaptive, seed, 5):
        for on in ("vertices", "triangles"):
            n_before, n_now = (getattr(m, f"n_{on}") for m in (step.before, step.after))
            matrix = adaptive.transfer_matrix(on)
            assert matrix.shape == (n_now, n_before)
            assert matrix.data.min() > 0.0
            np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-15)
            values = rng.normal(size=(n_before, 3))
            carried = adaptive.transfer(values, on)
            np.testing.assert_allclose(matrix @ values, carried, rtol=1e-14, atol=1e-14)
            for column in range(3):
                alone = adaptive.transfer(values[:, column], on)
                assert alone.tobytes() == carried[:, column].tobytes()


def refined_and_coarsened():
    """After a coarsening that takes back midpoints of 4T-SS here and there."""
    adaptive = AdaptiveMesh(meshes.uniform(4))
    adaptive.refine(everything(adaptive), "4T-SS")
    adaptive.refine([0, 5], "bisection")
    adaptive.coarsen(everything(adaptive))
    adaptive.refine([1], "4T-SS")
    before = adaptive.mesh
    adaptive.coarsen(np.arange(3 * before.n_triangles // 4))
    assert adaptive.n_triangles < before.n_triangles
    return before, adaptive


def just_refined():
    adaptive = AdaptiveMesh(meshes.uniform(4))
    before = adaptive.mesh
    adaptive.refine([3, 17], "4T-SS")
    return before, adaptive


CHANGES = pytest.mark.parametrize("change", [just_refined, refined_and_coarsened])
ON = pytest.mark.parametrize("on", ["vertices", "triangles"])


@ON
@CHANGES
@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 2), (2, 1, 3), (0,)])
def test_carries_values_of_any_number_of_dimensions(change, on, shape):
    before, adaptive = change()
    n_before = getattr(before, f"n_{on}")
    values = np.random.default_rng(0).normal(size=(n_before, *shape))
    carried = adaptive.transfer(values, on)
    wanted = adaptive.transfer_matrix(on) @ values.reshape(n_before, int(np.prod(shape)))
    assert carried.shape == (getattr(adaptive, f"n_{on}"), *shape)
    np.testing.assert_allclose(carried.reshape(wanted.shape), wanted, rtol=1e-14, atol=1e-14)
    turned = adaptive.transfer(np.asfortranarray(values), on)
    assert turned.tobytes() == carried.tobytes()


@ON
@CHANGES
@pytest.mark.parametrize(
    ("given_as", "comes_as"),
    [
        (np.float32, np.float32),
        (np.float64, np.float64),
        (np.complex64, np.complex64),
        (np.complex128, np.complex128),
        (np.int32, np.float64),
        (np.uint8, np.float64),
        (bool, np.float64),
        (">f8", ">f8"),
    ],
)
def test_keeps_floating_types_and_makes_others_float64(change, on, given_as, comes_as):
    before, adaptive = change()
    n_before = getattr(before, f"n_{on}")
    values = (np.arange(n_before) % 7).astype(given_as)
    if values.dtype.kind == "c":
        values = values * values.dtype.type(1 - 2j)
    carried = adaptive.transfer(values, on)
    assert carried.dtype == comes_as
    matrix = adaptive.transfer_matrix(on)
    np.testing.assert_allclose(carried, matrix @ values.astype(complex), rtol=1e-6)
    assert adaptive.transfer(values.tolist(), on).dtype.kind in "fc"


@ON
@CHANGES
def test_leaves_the_values_it_gets_alone_and_makes_new_ones(change, on):
    before, adaptive = change()
    values = np.random.default_rng(0).normal(size=getattr(before, f"n_{on}"))
    copy = values.copy()
    carried = adaptive.transfer(values, on)
    again = adaptive.transfer(values, on)
    carried[:] = -1.0
    assert values.tobytes() == copy.tobytes()
    values[:] = 5.0
    assert again.max() < 5.0
    unchanged = AdaptiveMesh(before)
    carried = unchanged.transfer(copy, on)
    carried[:] = -1.0
    assert copy.min() > -np.inf
    assert not np.shares_memory(carried, copy)


@ON
@CHANGES
@pytest.mark.parametrize("odd", [np.nan, np.inf])
def test_a_value_that_is_no_number_stays_where_it_is(change, on, odd):
    before, adaptive = change()
    matrix = adaptive.transfer_matrix(on).toarray()
    for n in range(getattr(before, f"n_{on}")):
        values = np.ones(getattr(before, f"n_{on}"))
        values[n] = odd
        carried = adaptive.transfer(values, on)
        assert (~np.isfinite(carried)).tolist() == (matrix[:, n] > 0.0).tolist()


@ON
def test_before_any_change_values_stay_as_they_are(on):
    mesh = meshes.uniform(2)
    adaptive = AdaptiveMesh(mesh)
    n = getattr(mesh, f"n_{on}")
    values = np.random.default_rng(0).normal(size=n)
    assert adaptive.transfer(values, on).tobytes() == values.tobytes()
    np.testing.assert_array_equal(adaptive.transfer_matrix(on).toarray(), np.eye(n))


@CHANGES
@ON
def test_wants_a_value_for_each_vertex_or_triangle_of_the_mesh_before(change, on):
    before, adaptive = change()
    n_before, n_now = getattr(before, f"n_{on}"), getattr(adaptive, f"n_{on}")
    for values in [np.zeros(n_now), np.zeros(n_before + 1), np.zeros((0, 2)), 3.0]:
        with pytest.raises(
            ValueError,
            match=rf"a value is wanted for each of {n_before} {on} before the last change, got an "
            rf"array of shape \({str(np.shape(values))[1:-1]}\)",
        ):
            adaptive.transfer(values, on)


@pytest.mark.parametrize("on", ["edges", "", None, "vertex"])
def test_wants_values_on_vertices_or_triangles(on):
    adaptive = AdaptiveMesh(SQUARE)
    wanted = f'on must be "vertices" or "triangles", got {on!r}'
    with pytest.raises(ValueError, match=wanted):
        adaptive.transfer([0.0] * 4, on)
    with pytest.raises(ValueError, match=wanted):
        adaptive.transfer_matrix(on)


def test_says_how_to_get_scipy_for_a_matrix(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.sparse", None)
    with pytest.raises(ImportError, match=r"a matrix needs SciPy.*pip install \"rtin\[fem\]\""):
        AdaptiveMesh(SQUARE).transfer_matrix()


# --- heights and tags ---------------------------------------------------------------------------


@given(terrains.rasters(largest=9), st.sampled_from(meshes.EXACT), meshes.seeds)
def test_new_vertices_get_the_heights_of_the_raster_again_and_again(heights, transform, seed):
    grid = rtin.Grid(heights, meshes.TRANSFORMS[transform])
    mesh = rtin.coarsen(grid, max_error=20.0)
    adaptive = AdaptiveMesh(mesh, heights=grid)
    for step in walk(adaptive, seed, 6):
        vertices = step.after.vertices
        assert vertices[: mesh.n_vertices].tobytes() == mesh.vertices.tobytes()
        wanted = grid.heights_at(vertices[:, :2])
        known = ~np.isnan(wanted)
        assert vertices[known, 2].tolist() == wanted[known].tolist()
        ends = vertices[adaptive.midpoint_parents]
        midway = np.arange(len(vertices)) >= mesh.n_vertices
        rows = midway & ~known
        assert vertices[rows, 2].tolist() == ends[rows, :, 2].mean(axis=1).tolist()


def test_a_vertex_that_comes_back_has_the_same_height():
    grid = rtin.Grid(terrains.noise((9, 9)))
    adaptive = AdaptiveMesh(rtin.coarsen(grid, max_error=30.0), heights=grid)
    adaptive.refine(everything(adaptive))
    before = bytes_of(adaptive)
    for _ in range(3):
        adaptive.coarsen(adaptive.refine(everything(adaptive), "4T-SS"))
        assert bytes_of(adaptive) == before


@given(meshes.any_mesh, meshes.seeds)
def test_tags_and_the_crs_are_those_of_the_root(mesh, seed):
    mesh = TriangleMesh(
        mesh.vertices, mesh.triangles, "EPSG:32633", np.arange(mesh.n_triangles) % 3
    )
    adaptive = AdaptiveMesh(mesh)
    for step in walk(adaptive, seed, 6):
        assert step.after.crs == mesh.crs
        assert step.after.tags.tolist() == mesh.tags[adaptive.roots].tolist()
        x, y = step.after.vertices[step.after.triangles, :2].mean(axis=1).T
        corners = mesh.vertices[mesh.triangles[adaptive.roots], :2]
        for start, end in pairwise([0, 1, 2, 0]):
            along = (corners[:, end] - corners[:, start]).T
            turn = along[0] * (y - corners[:, start, 1]) - along[1] * (x - corners[:, start, 0])
            assert (turn > 0.0).all()


def test_a_mesh_without_tags_has_none_later():
    assert walked(SQUARE, 0, 4).mesh.tags is None


# --- a long way ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_ten_thousand_small_steps_leave_a_right_mesh(seed):
    rng = np.random.default_rng(seed)
    mesh = meshes.uniform(4) if seed else meshes.delaunay(rng.random((20, 2)), rng)
    adaptive = AdaptiveMesh(mesh)
    area, recent, n_merged = mesh.signed_areas(), [np.arange(mesh.n_triangles)], 0
    for _ in range(10_000):
        if adaptive.n_triangles < 1000 and rng.random() < 0.45:
            target = int(rng.integers(adaptive.n_triangles))
            recent.append(adaptive.refine([target], SCHEMES[rng.integers(3)]))
        else:
            around = recent.pop(rng.integers(len(recent))) if len(recent) > 1 else recent[0]
            n_merged += len(adaptive.coarsen(around[around < adaptive.n_triangles]))
            if adaptive.n_triangles >= 1000:
                n_merged += len(adaptive.coarsen(rng.random(adaptive.n_triangles) < 0.9))
    assert n_merged > 5000
    now = adaptive.mesh
    validity.check(now)
    np.testing.assert_allclose(np.bincount(adaptive.roots, now.signed_areas()), area)
    refined = rtin.refine(now, np.arange(now.n_triangles))
    adaptive.refine(everything(adaptive))
    assert sorted(places_of(adaptive.mesh)) == sorted(places_of(refined))
    while adaptive.coarsen(everything(adaptive)).size:
        pass
    assert bytes_of(adaptive) == bytes_of(AdaptiveMesh(mesh))


def room(adaptive):
    """Bytes that it holds."""
    return sum(array.nbytes for array in adaptive._state)


def test_needs_no_more_room_for_going_back_and_forth():
    adaptive = AdaptiveMesh(meshes.uniform(4))
    rng = np.random.default_rng(0)
    rooms = []
    for _ in range(300):
        adaptive.refine(rng.integers(0, adaptive.n_triangles, 5), SCHEMES[rng.integers(3)])
        while adaptive.n_triangles > 40 and adaptive.coarsen(everything(adaptive)).size:
            pass
        rooms.append(room(adaptive))
    assert rooms[-1] == rooms[20]


def test_copies_to_a_larger_place_get_rarer():
    """As often as the mesh doubles, not as often as it changes."""
    adaptive = AdaptiveMesh(SQUARE)
    rng = np.random.default_rng(0)
    rooms = set()
    for _ in range(2000):
        adaptive.refine([rng.integers(adaptive.n_triangles)])
        rooms.add(room(adaptive))
    assert adaptive.n_triangles > 8000
    assert len(rooms) < 25
    validity.check(adaptive.mesh)


# --- what one holds stays as it is --------------------------------------------------------------


@given(meshes.any_mesh, meshes.seeds)
def test_meshes_that_were_read_do_not_change(mesh, seed):
    mesh = tagged(mesh)
    adaptive = AdaptiveMesh(mesh)
    held = [(mesh, [a.tobytes() for a in (mesh.vertices, mesh.triangles, mesh.tags)])]
    arrays = []
    for step in walk(adaptive, seed, 6):
        now = step.after
        assert adaptive.mesh is now
        held.append((now, [a.tobytes() for a in (now.vertices, now.triangles, now.tags)]))
        read = [adaptive.roots, adaptive.levels, adaptive.midpoint_parents, adaptive.parents]
        arrays += [(array, array.tobytes()) for array in [*read, step.returned]]
    for snapshot, contents in held:
        parts = snapshot.vertices, snapshot.triangles, snapshot.tags
        assert [array.tobytes() for array in parts] == contents
        assert not any(array.flags.writeable for array in parts)
    assert all(array.tobytes() == contents for array, contents in arrays)


def test_what_is_written_into_arrays_that_were_read_is_not_read_again():
    adaptive = AdaptiveMesh(meshes.uniform(2))
    adaptive.refine([0])
    before = bytes_of(adaptive)
    for name in ("roots", "levels", "midpoint_parents", "parents"):
        getattr(adaptive, name)[:] = 1
    assert bytes_of(adaptive) == before
    new = adaptive.refine([1])
    new[:] = 0
    state = bytes_of(adaptive)
    adaptive.coarsen([0])[:] = 5
    assert bytes_of(adaptive) == state


def test_copies_the_mesh_it_is_given():
    vertices = np.array(SQUARE.vertices)
    triangles = np.array(SQUARE.triangles)
    tags = np.array([1, 2], np.int32)
    adaptive = AdaptiveMesh(TriangleMesh(vertices, triangles, None, tags))
    vertices[:], triangles[:], tags[:] = 99.0, 0, 99
    assert adaptive.mesh.vertices.tolist() == SQUARE.vertices.tolist()
    assert adaptive.mesh.triangles.tolist() == SQUARE.triangles.tolist()
    adaptive.refine([0])
    assert adaptive.mesh.vertices[:4].tolist() == SQUARE.vertices.tolist()
    assert set(adaptive.mesh.tags.tolist()) == {1, 2}


# --- bad usage ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("targets", "error", "message"),
    [
        ([0, 99], IndexError, "there are 6 triangles.*; got 99"),
        ([6], IndexError, "there are 6 triangles.*; got 6"),
        ([-1], IndexError, "there are 6 triangles.*; got -1"),
        ([0.0], TypeError, "numbers of triangles or a boolean for each.*got an array of float64"),
        ("all", TypeError, "numbers of triangles or a boolean for each.*got an array"),
        (None, TypeError, "numbers of triangles or a boolean for each.*got NoneType"),
        ([[0, 1]], ValueError, r"must be in one dimension, got shape \(1, 2\)"),
        ([True] * 5, ValueError, "a mask of .* must have a value for each of 6.*, got 5"),
        ([True] * 7, ValueError, "a mask of .* must have a value for each of 6.*, got 7"),
    ],
)
def test_says_what_is_wrong_with_targets_and_changes_nothing(targets, error, message):
    adaptive = AdaptiveMesh(SQUARE)
    adaptive.refine([0])
    before, parents = bytes_of(adaptive), adaptive.parents.tolist()
    for change in (adaptive.refine, adaptive.coarsen):
        with pytest.raises(error, match=message):
            change(targets)
        assert bytes_of(adaptive) == before
        assert adaptive.parents.tolist() == parents
    assert adaptive.coarsen(everything(adaptive)).tolist() == [0, 1]


def test_names_the_schemes_there_are():
    adaptive = AdaptiveMesh(SQUARE)
    with pytest.raises(ValueError, match="scheme must be one of 4T-LE, 4T-SS, bisection, got '4t'"):
        adaptive.refine([0], "4t")
    assert adaptive.n_triangles == 2


def test_wants_a_triangle_mesh_and_a_grid():
    with pytest.raises(TypeError, match="a TriangleMesh is wanted, got list"):
        AdaptiveMesh([[0, 1, 2]])
    with pytest.raises(TypeError, match="Grid"):
        AdaptiveMesh(SQUARE, heights=np.zeros((3, 3)))


def test_wants_a_conforming_mesh():
    hanging = TriangleMesh(
        [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]], [[0, 2, 3], [1, 4, 0], [2, 4, 1]]
    )
    with pytest.raises(validity.InvalidMesh, match="vertex 4 hangs inside edge 0-2 of triangle 0"):
        AdaptiveMesh(hanging)
    turned = TriangleMesh(SQUARE.vertices, SQUARE.triangles[:, ::-1])
    with pytest.raises(validity.InvalidMesh, match="clockwise"):
        AdaptiveMesh(turned)


@pytest.mark.parametrize("n_vertices", [0, 3])
def test_a_mesh_without_triangles_stays_so(n_vertices):
    mesh = TriangleMesh(np.zeros((n_vertices, 3)), np.empty((0, 3), int))
    adaptive = AdaptiveMesh(mesh)
    for change in (adaptive.refine, adaptive.coarsen):
        assert change([]).size == 0
        assert (adaptive.n_vertices, adaptive.n_triangles) == (n_vertices, 0)
        assert adaptive.transfer(np.zeros(n_vertices)).shape == (n_vertices,)
        assert adaptive.transfer(np.zeros(0), "triangles").shape == (0,)
    assert adaptive.mesh.vertices.tobytes() == mesh.vertices.tobytes()


def far_away():
    """Two triangles that float64 can split a few times, and eight that it can split often."""
    far = SQUARE.vertices / 8 + [2.0**40, 0.0, 0.0]
    near = meshes.uniform(2)
    return TriangleMesh(
        np.vstack([far, near.vertices]), np.vstack([SQUARE.triangles, 4 + near.triangles])
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_says_when_refine_does_that_a_triangle_is_too_small(scheme):
    adaptive = AdaptiveMesh(far_away())
    for _ in range(30):
        tiny = (adaptive.mesh.triangles == 0).any(axis=1)
        try:
            rtin.refine(adaptive.mesh, tiny, scheme)
        except ValueError as error:
            with pytest.raises(ValueError, match=re.escape(str(error))):
                adaptive.refine(tiny, scheme)
            return
        adaptive.refine(tiny, scheme)
        assert meshes.is_right(adaptive.mesh)
    pytest.fail("never")


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("has_free_slots", [False, True])
def test_a_triangle_too_small_to_split_changes_nothing(scheme, has_free_slots):
    adaptive = AdaptiveMesh(far_away())
    while True:
        tiny = (adaptive.mesh.triangles == 0).any(axis=1)
        try:
            adaptive.refine(tiny, "bisection")
        except ValueError:
            break
        assert adaptive.n_triangles < 1000
    if has_free_slots:
        adaptive.coarsen(adaptive.refine(np.flatnonzero(adaptive.roots == 4)))
    before, parents = bytes_of(adaptive), adaptive.parents.tolist()
    matrices = [adaptive.transfer_matrix(on).toarray() for on in ("vertices", "triangles")]
    never_failed = copy.deepcopy(adaptive)
    for _ in range(3):
        with pytest.raises(
            ValueError,
            match="a triangle is too small or too thin to be split in float64: "
            r"\(1099511627776[0-9.]*, .*; refine less there, or move the mesh closer to the origin",
        ):
            adaptive.refine(everything(adaptive), scheme)
        assert bytes_of(adaptive) == before
        assert adaptive.parents.tolist() == parents
        for on, matrix in zip(("vertices", "triangles"), matrices, strict=True):
            assert (adaptive.transfer_matrix(on).toarray() == matrix).all()
    elsewhere = np.flatnonzero(adaptive.roots >= 2)
    wanted = rtin.refine(adaptive.mesh, elsewhere, scheme)
    new = adaptive.refine(elsewhere, scheme)
    never_failed.refine(elsewhere, scheme)
    assert bytes_of(adaptive) == bytes_of(never_failed)
    assert sorted(places_of(adaptive.mesh)) == sorted(places_of(wanted))
    adaptive.coarsen(new)
    assert bytes_of(adaptive) == before
    while adaptive.coarsen(everything(adaptive)).size:
        pass
    assert bytes_of(adaptive) == bytes_of(AdaptiveMesh(far_away()))


def test_counts_more_than_255_levels():
    """Towards the origin, where float64 is finest."""
    adaptive = AdaptiveMesh(SQUARE)
    for _ in range(140):
        adaptive.refine((adaptive.mesh.triangles == 0).any(axis=1))
    area = SQUARE.signed_areas()[adaptive.roots]
    np.testing.assert_allclose(adaptive.mesh.signed_areas(), area * 0.5**adaptive.levels)


def test_survives_a_lack_of_memory(monkeypatch):
    adaptive = walked(SQUARE, 1, 3)
    before, now = bytes_of(adaptive), adaptive.mesh

    def no_memory(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr("rtin.adaptive._grown", no_memory)
        while True:
            try:
                new = adaptive.refine(everything(adaptive))
            except MemoryError:
                break
            before, now = bytes_of(adaptive), adaptive.mesh
    assert bytes_of(adaptive) == before
    new = adaptive.refine([0], "bisection")
    wanted = rtin.refine(now, [0], "bisection")
    assert sorted(places_of(adaptive.mesh)) == sorted(places_of(wanted))
    adaptive.coarsen(new)
    assert bytes_of(adaptive) == before


def test_says_how_large_it_is():
    assert repr(walked(SQUARE, 0, 0)) == "<AdaptiveMesh 4 vertices, 2 triangles>"


def test_the_docstrings_examples_run():
    module = importlib.import_module("rtin.adaptive")
    found = doctest.testmod(module, raise_on_error=True)
    assert found.attempted > 4


# --- when something fails in the middle ---------------------------------------------------------


@pytest.mark.parametrize("kernel", ["mark_targets", "split_marked", "coarsen_targets"])
@pytest.mark.parametrize("comes", ["before", "after"])
def test_an_interrupt_leaves_it_whole(monkeypatch, kernel, comes):
    """Ctrl-C takes effect before a kernel or when it returns; its result is lost then."""
    adaptive = AdaptiveMesh(SQUARE)
    adaptive.refine([0, 1])
    new = adaptive.refine([0, 5])
    before = bytes_of(adaptive)
    original = getattr(kernels, kernel)

    def interrupted(*arguments):
        if comes == "after":
            original(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(kernels, kernel, interrupted)
    with pytest.raises(KeyboardInterrupt):
        adaptive.coarsen(new) if kernel == "coarsen_targets" else adaptive.refine([3])
    monkeypatch.undo()
    assert adaptive.mesh.n_triangles == adaptive.n_triangles
    validity.check(adaptive.mesh)
    if comes == "before" or kernel == "mark_targets":
        assert bytes_of(adaptive) == before
        adaptive.transfer(np.zeros(adaptive._change.n_vertices))
    else:
        with pytest.raises(RuntimeError, match="the last change was interrupted"):
            adaptive.transfer(np.zeros(adaptive.n_vertices))
        with pytest.raises(RuntimeError, match="the last change was interrupted"):
            adaptive.parents  # noqa: B018
    n, mesh = adaptive.n_triangles, adaptive.mesh
    again = adaptive.refine([3])
    assert adaptive.n_triangles > n
    adaptive.coarsen(again)
    assert adaptive.mesh.triangles.tobytes() == mesh.triangles.tobytes()


def test_a_lack_of_memory_in_a_kernel_changes_nothing(monkeypatch):
    adaptive = walked(SQUARE, 1, 3)
    before = bytes_of(adaptive)

    def out_of_memory(*_):
        raise MemoryError

    monkeypatch.setattr(kernels, "split_marked", out_of_memory)
    with pytest.raises(MemoryError):
        adaptive.refine([0])
    monkeypatch.undo()
    assert bytes_of(adaptive) == before
    assert len(adaptive.refine([0])) >= 4


def test_counts_calls_anew_before_they_get_too_many():
    adaptive, twin = AdaptiveMesh(SQUARE), AdaptiveMesh(SQUARE)
    for mesh in (adaptive, twin):
        mesh.refine([0])
        mesh.refine([1, 2])
    adaptive._state.counts[kernels.LATEST] = np.iinfo(np.int32).max
    for mesh in (adaptive, twin):
        new = mesh.refine([3])
        mesh.coarsen(new)
        mesh.coarsen(range(mesh.n_triangles))
    assert adaptive._state.counts[kernels.LATEST] < 10
    assert bytes_of(adaptive) == bytes_of(twin)


def test_a_copy_goes_its_own_way():
    adaptive = walked(SQUARE, 1, 3)
    before = bytes_of(adaptive)
    other = copy.copy(adaptive)
    other.refine(range(other.n_triangles))
    assert bytes_of(adaptive) == before
    assert bytes_of(copy.deepcopy(adaptive)) == before


def test_values_that_are_no_numbers_are_refused():
    adaptive = AdaptiveMesh(SQUARE)
    with pytest.raises(TypeError, match="values must be numbers, got an array of object"):
        adaptive.transfer([None] * 4)
