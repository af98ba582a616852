"""`refine` against its naive twin, the laws of refinement, its docstring, and scikit-fem."""

import re
from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import hand_meshes
import meshes
import naive
import rtin
import terrains
from rtin import validity
from rtin.mesh import TriangleMesh
from test_validity import FAULTS

SCHEMES = meshes.SCHEMES
SQUARE = TriangleMesh.from_triangles(
    [[0, 0, 1], [2, 0, 2], [2, 2, 3], [0, 2, 4]], [[0, 1, 2], [0, 2, 3]]
)


def bytes_of(mesh):
    tags = None if mesh.tags is None else mesh.tags.tobytes()
    return mesh.vertices.tobytes(), mesh.triangles.tobytes(), tags


def tagged(mesh):
    """The mesh with triangles' own numbers as tags, so that children tell their parents."""
    return TriangleMesh(mesh.vertices, mesh.triangles, mesh.crs, np.arange(mesh.n_triangles))


def with_places(mesh, number=float):
    """Each triangle as its three places."""
    places = [tuple(map(number, place)) for place in mesh.vertices.tolist()]
    return [tuple(places[corner] for corner in corners) for corners in mesh.triangles.tolist()]


def set_of_places(mesh):
    """Without the numbering: each triangle as its places, the edge to bisect first in front."""
    triangles = with_places(mesh)
    assert len(set(triangles)) == mesh.n_triangles
    return set(triangles)


def steps(mesh, scheme, seed, n_steps, **options):
    """(mesh, targets, refined mesh) of random refinements, one after another."""
    rng = np.random.default_rng(seed)
    for _ in range(n_steps):
        targets = meshes.targets_of(mesh, rng)
        refined = rtin.refine(mesh, targets, scheme, **options)
        yield mesh, targets, refined
        mesh = refined


def squared_sides(mesh):
    """Squared lengths of sides 0, 1, 2 in the xy plane, shape (m, 3)."""
    corners = mesh.vertices[mesh.triangles, :2]
    return ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2)


def smallest_angle(mesh):
    corners = mesh.vertices[mesh.triangles, :2]
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    cross = ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0]
    return np.arctan2(cross, (ahead * back).sum(axis=2)).min()


# --- against the naive twin ---------------------------------------------------------------------


def assert_is_the_papers(mesh, targets, scheme, refined, number=float):
    midpoints, triangles = naive.refined(with_places(mesh, number), targets, scheme)
    old, new = np.split(refined.vertices, [mesh.n_vertices])
    assert old.tobytes() == mesh.vertices.tobytes()
    assert [tuple(map(number, place)) for place in new.tolist()] == midpoints
    assert with_places(refined, number) == triangles


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_is_the_papers_algorithm_step_after_step(mesh, scheme, seed):
    for before, targets, refined in steps(mesh, scheme, seed, 3):
        assert_is_the_papers(before, targets, scheme, refined)


@given(meshes.right_triangulated(meshes.EXACT), meshes.schemes, meshes.seeds)
def test_is_exact_on_a_lattice(mesh, scheme, seed):
    for before, targets, refined in steps(mesh, scheme, seed, 2):
        assert_is_the_papers(before, targets, scheme, refined, Fraction)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_follows_a_long_way_over_ever_longer_edges(scheme):
    """A strip in which each triangle's longest edge is shared with the next, longer one."""
    mesh = ever_longer(25)
    refined = rtin.refine(mesh, [0], scheme)
    assert_is_the_papers(mesh, [0], scheme, refined)
    assert refined.n_triangles >= 2 * mesh.n_triangles
    backwards = rtin.refine(mesh, [24], scheme)
    assert_is_the_papers(mesh, [24], scheme, backwards)
    assert backwards.n_triangles <= mesh.n_triangles + 6


def ever_longer(n_triangles):
    turn, growth = np.radians(14.0), 1.25
    number = np.arange(n_triangles + 2)
    points = growth**number * np.exp(1j * turn * number)
    # A fan around the origin: spokes grow, and the longest edge is the later spoke.
    vertices = np.column_stack([np.r_[0.0, points.real], np.r_[0.0, points.imag], np.r_[0, number]])
    first = np.arange(1, n_triangles + 1)
    sheets = np.column_stack([0 * first, first, first + 1])
    return TriangleMesh.from_triangles(vertices, sheets)


# --- laws ---------------------------------------------------------------------------------------


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_stays_a_right_mesh_and_turns_no_triangle_over(mesh, scheme, seed):
    for _, _, refined in steps(mesh, scheme, seed, 4):
        assert meshes.is_right(refined)
        assert (refined.signed_areas() > 0.0).all()


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_children_are_consecutive_and_cover_their_parent(mesh, scheme, seed):
    for before, targets, refined in steps(tagged(mesh), scheme, seed, 3):
        before, refined = tagged(before), rtin.refine(tagged(before), targets, scheme)
        parents = refined.tags
        assert (np.diff(parents) >= 0).all()
        area, areas = before.signed_areas(), refined.signed_areas()
        np.testing.assert_allclose(np.bincount(parents, areas), area, rtol=1e-6)
        # In barycentric coordinates of the parent, no corner of a child is outside.
        a, b, c = before.vertices[before.triangles[parents], :2].transpose(1, 0, 2)
        for corner in refined.vertices[refined.triangles, :2].transpose(1, 0, 2):
            for start, end in [(a, b), (b, c), (c, a)]:
                along, to = end - start, corner - start
                turn = along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]
                assert (turn >= -1e-6 * area[parents]).all()


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_splits_every_target_and_leaves_what_has_no_mark(mesh, scheme, seed):
    for before, targets, refined in steps(mesh, scheme, seed, 3):
        refined = rtin.refine(tagged(before), targets, scheme)
        n_children = np.bincount(refined.tags, minlength=before.n_triangles)
        assert n_children.min() >= 1
        assert n_children.max() <= 4
        if scheme == "bisection":
            assert (n_children[targets] >= 2).all()
        else:
            assert (n_children[targets] == 4).all()
        alone = np.flatnonzero(n_children == 1)
        kept = refined.triangles[np.isin(refined.tags, alone)]
        assert kept.tolist() == before.triangles[alone].tolist()


@given(meshes.tins(), meshes.schemes, meshes.seeds)
def test_no_angle_falls_below_half_of_the_smallest(mesh, scheme, seed):
    least = 0.5 * smallest_angle(mesh) * (1.0 - 1e-6)
    for _, _, refined in steps(mesh, scheme, seed, 6):
        assert smallest_angle(refined) >= least


@pytest.mark.parametrize("scheme", SCHEMES)
def test_no_angle_falls_below_half_around_one_point(scheme):
    """The triangles at one corner, again and again: sizes differ ever more."""
    mesh = meshes.delaunay(np.random.default_rng(5).random((12, 2)), np.random.default_rng(6))
    least = 0.5 * smallest_angle(mesh) * (1.0 - 1e-6)
    for _ in range(25):
        mesh = rtin.refine(mesh, (mesh.triangles == 0).any(axis=1), scheme)
        assert smallest_angle(mesh) >= least
    validity.check(mesh)
    assert mesh.n_triangles < 3000


@pytest.mark.parametrize("mix", [0, 1, 2])
def test_no_angle_falls_below_half_when_schemes_alternate(mix):
    rng = np.random.default_rng(mix)
    mesh = meshes.delaunay(rng.random((15, 2)), rng)
    least = 0.5 * smallest_angle(mesh) * (1.0 - 1e-6)
    for step in range(9):
        mesh = rtin.refine(mesh, rng.random(mesh.n_triangles) < 0.1, SCHEMES[(step + mix) % 3])
        assert smallest_angle(mesh) >= least


@given(
    st.sampled_from(list(meshes.TRANSFORMS)),
    terrains.rasters(largest=9),
    terrains.tolerances,
    meshes.schemes,
    meshes.seeds,
)
def test_right_isosceles_triangles_of_a_lattice_stay_so(
    transform, heights, tolerance, scheme, seed
):
    transform = meshes.TRANSFORMS[transform]
    mesh = rtin.coarsen(rtin.Grid(heights, transform), max_error=tolerance)
    for _, _, refined in steps(mesh, scheme, seed, 4):
        hypotenuse, leg, other = squared_sides(on_the_lattice(refined, transform)).T
        np.testing.assert_allclose(leg, other, rtol=1e-4)
        np.testing.assert_allclose(hypotenuse, 2.0 * leg, rtol=1e-4)


def on_the_lattice(mesh, transform):
    origin = np.array([transform.c, transform.f])
    linear = np.array([[transform.a, transform.b], [transform.d, transform.e]])
    places = (mesh.vertices[:, :2] - origin) @ np.linalg.inv(linear).T
    return TriangleMesh(np.column_stack([places, mesh.vertices[:, 2]]), mesh.triangles)


@pytest.mark.parametrize("transform", meshes.EXACT)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_right_isosceles_triangles_stay_exactly_so(scheme, transform):
    """Twelve steps towards a corner of cells of every shape: no digit is lost."""
    mesh = meshes.uniform(2, meshes.TRANSFORMS[transform])
    scale = np.abs(np.diff(np.sort(mesh.vertices[:, :2], axis=0), axis=0)).max(axis=0)
    for _ in range(12):
        mesh = rtin.refine(mesh, (mesh.triangles == 4).any(axis=1), scheme)
        square = TriangleMesh(mesh.vertices / [*scale, 1.0], mesh.triangles)
        hypotenuse, leg, other = squared_sides(square).T
        if transform in ("north up", "south up", "wide cells", "tall cells"):
            assert (leg == other).all()
            assert (hypotenuse == 2.0 * leg).all()
        else:
            np.testing.assert_allclose(leg, other, rtol=1e-9)
            np.testing.assert_allclose(hypotenuse, 2.0 * leg, rtol=1e-9)


@given(meshes.any_mesh, st.sampled_from(["4T-LE", "4T-SS"]))
def test_uniform_refinement_adds_a_vertex_per_edge_and_makes_four_of_each(mesh, scheme):
    refined = rtin.refine(mesh, np.arange(mesh.n_triangles), scheme)
    assert refined.n_vertices == mesh.n_vertices + len(mesh.edges())
    assert refined.n_triangles == 4 * mesh.n_triangles
    lengths = np.sort(squared_sides(refined).sum(axis=1).reshape(-1, 4), axis=1)
    if scheme == "4T-SS":  # four congruent ones
        parents = squared_sides(mesh).sum(axis=1)
        np.testing.assert_allclose(lengths, np.tile(parents[:, None] / 4, 4), rtol=1e-6)


@pytest.mark.parametrize("n_steps", [1, 2, 3])
@pytest.mark.parametrize("transform", ["north up", "wide cells", "oblong cells"])
def test_uniform_refinement_of_a_lattice_is_the_finer_lattice(transform, n_steps):
    transform = meshes.TRANSFORMS[transform]
    wanted = meshes.uniform(2 << n_steps, transform @ Affine.scale(0.5**n_steps))
    for scheme in SCHEMES:
        mesh = meshes.uniform(2, transform)
        for _ in range(n_steps if scheme != "bisection" else 2 * n_steps):
            mesh = rtin.refine(mesh, np.full(mesh.n_triangles, True), scheme)
        assert mesh.n_vertices == ((2 << n_steps) + 1) ** 2
        if scheme != "4T-SS":  # which makes the same shapes, but turned
            assert set_of_flat_places(mesh) == set_of_flat_places(wanted)


def set_of_flat_places(mesh):
    return {tuple(place[:2] for place in triangle) for triangle in with_places(mesh)}


@given(meshes.any_mesh)
def test_bisecting_all_triangles_adds_the_middles_of_their_first_edges_and_no_more(mesh):
    refined = rtin.refine(mesh, np.full(mesh.n_triangles, True), "bisection")
    first = {frozenset(map(int, corners[:2])) for corners in mesh.triangles}
    assert refined.n_vertices == mesh.n_vertices + len(first)
    marks = [
        sum(frozenset(edge) in first for edge in ((a, b), (b, c), (c, a)))
        for a, b, c in mesh.triangles.tolist()
    ]
    assert refined.n_triangles == sum(marks) + mesh.n_triangles


# --- the docstring ------------------------------------------------------------------------------


def table():
    """{(sides bisected, scheme or None): the children in letters} as the docstring has it."""
    rule = r"\s+=+  =+\n"
    body = re.search(f"{rule}.*\n{rule}((?:.*\n)*?){rule}", rtin.refine.__doc__)[1]
    rows = {}
    for line in body.splitlines():
        sides, children = re.split(r"\s{2,}", line.strip(), maxsplit=1)
        *sides, last = [side.strip() for side in sides.split(",")]
        scheme = last if last in SCHEMES else None
        sides = frozenset(sides if scheme else [*sides, last])
        rows[frozenset({"ab", "bc", "ca"}) if "all" in sides else sides, scheme] = children.split()
    return rows


def test_the_docstrings_table_has_a_row_for_each_way_to_split():
    all_sides = frozenset({"ab", "bc", "ca"})
    assert set(table()) == {
        (frozenset({"ab"}), None),
        (frozenset({"ab", "bc"}), None),
        (frozenset({"ab", "ca"}), None),
        (all_sides, "4T-LE"),
        (all_sides, "4T-SS"),
    }


SIDE_OF = {"m": "ab", "p": "bc", "q": "ca"}


def test_children_are_those_of_the_docstrings_table():
    rows, met = table(), set()
    for seed in range(12):
        scheme = SCHEMES[seed % 3]
        rng = np.random.default_rng(seed)
        mesh = tagged(meshes.delaunay(rng.random((25, 2)), rng))
        refined = rtin.refine(mesh, meshes.targets_of(mesh, rng), scheme)
        number_at = {place[:2]: n for n, place in enumerate(map(tuple, refined.vertices.tolist()))}
        for parent, corners in enumerate(mesh.triangles):
            letters = dict(zip("abc", corners.tolist(), strict=True))
            places = dict(zip("abc", map(tuple, mesh.vertices[corners].tolist()), strict=True))
            for letter, side in SIDE_OF.items():
                place = naive.middle(*(places[end] for end in side))[:2]
                if place in number_at:
                    letters[letter] = number_at[place]
            sides = frozenset(SIDE_OF[n] for n in "mpq" if n in letters)
            row = (sides, (scheme if scheme == "4T-SS" else "4T-LE") if len(sides) == 3 else None)
            children = [[letters[n] for n in child] for child in rows.get(row, ["abc"])]
            found = refined.triangles[refined.tags == parent].tolist()
            assert [cyclic(child) for child in found] == [cyclic(child) for child in children]
            met.add(row)
    assert met - {(frozenset(), None)} == set(rows)


def cyclic(corners):
    """The same for all rotations."""
    at = corners.index(min(corners))
    return corners[at:] + corners[:at]


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_midpoints_come_in_the_order_in_which_one_meets_them(mesh, scheme, seed):
    for before, _, refined in steps(mesh, scheme, seed, 2):
        new = [tuple(place) for place in refined.vertices[before.n_vertices :].tolist()]
        met = dict.fromkeys(
            naive.middle(*edge)
            for triangle in with_places(before)
            for edge in naive.edges_of(triangle, directed=True)
        )
        assert len(set(new)) == len(new)
        assert [place for place in met if place in set(new)] == new


@given(meshes.tins(), meshes.schemes, meshes.seeds)
def test_the_first_edge_of_each_child_is_its_longest_or_ties(mesh, scheme, seed):
    for _, _, refined in steps(mesh, scheme, seed, 3):
        first, second, third = squared_sides(refined).T
        longest = np.maximum(second, third)
        right_angle_before = np.abs(second - third) <= 1e-6 * longest
        assert ((first >= longest * (1 - 1.1e-6)) | right_angle_before).all()


# --- what must not matter -----------------------------------------------------------------------


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_ways_to_name_targets_agree(mesh, scheme, seed):
    rng = np.random.default_rng(seed)
    targets = meshes.targets_of(mesh, rng)
    mask = np.zeros(mesh.n_triangles, bool)
    mask[targets] = True
    wanted = bytes_of(rtin.refine(mesh, targets, scheme))
    once = iter([mask, []])
    for same in [
        mask,
        mask.tolist(),
        targets.tolist(),
        targets.astype(np.uint8),
        targets.astype(">i4"),
        rng.permutation(np.repeat(targets, 3)),
        lambda _: next(once),
    ]:
        assert bytes_of(rtin.refine(mesh, same, scheme)) == wanted


@given(meshes.any_mesh, meshes.schemes)
def test_all_triangles_are_all_triangles_however_they_are_named(mesh, scheme):
    wanted = bytes_of(rtin.refine(mesh, range(mesh.n_triangles), scheme))
    assert bytes_of(rtin.refine(mesh, np.full(mesh.n_triangles, True), scheme)) == wanted
    backwards = np.arange(mesh.n_triangles)[::-1].repeat(2)
    assert bytes_of(rtin.refine(mesh, backwards, scheme)) == wanted


@given(meshes.any_mesh, meshes.schemes)
def test_no_targets_change_nothing(mesh, scheme):
    mesh = tagged(mesh)
    for none in ([], np.empty(0, int), np.zeros(mesh.n_triangles, bool), lambda _: []):
        assert bytes_of(rtin.refine(mesh, none, scheme)) == bytes_of(mesh)


@pytest.mark.parametrize("n_vertices", [0, 3])
def test_a_mesh_without_triangles_stays_so(n_vertices):
    mesh = TriangleMesh(np.zeros((n_vertices, 3)), np.empty((0, 3), int), "EPSG:2056", [])
    for targets in ([], np.empty(0, bool), lambda _: []):
        refined = rtin.refine(mesh, targets)
        assert bytes_of(refined) == bytes_of(mesh)


@given(meshes.tins() | meshes.right_triangulated(["north up"]), meshes.schemes, meshes.seeds)
def test_numbering_does_not_matter(mesh, scheme, seed):
    """Vertices, triangles and corners in any order, or clockwise: the same places come out."""
    rng = np.random.default_rng(seed)
    other = meshes.renumbered(mesh, rng)
    other = TriangleMesh.from_triangles(other.vertices, rng.permuted(other.triangles, axis=1))
    for _ in range(3):
        targets = meshes.targets_of(mesh, rng)
        corners = with_places(mesh)
        wanted = {corners[target] for target in targets}
        mask = [triangle in wanted for triangle in with_places(other)]
        mesh, other = rtin.refine(mesh, targets, scheme), rtin.refine(other, mask, scheme)
        assert set_of_places(other) == set_of_places(mesh)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_threads_change_no_byte(monkeypatch, scheme):
    """With so many triangles that they are worked off in several bands, and vertices too."""
    rng = np.random.default_rng(2)
    for mesh in (meshes.uniform(32), meshes.delaunay(rng.random((3000, 2)), rng)):
        mesh = tagged(meshes.renumbered(mesh, rng))
        assert mesh.n_triangles > 2000
        marks = [rng.random(mesh.n_triangles) < share for share in (0.001, 0.2, 1.1)]
        results = []
        for n_threads in ("1", "2", "5"):
            monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
            once = [rtin.refine(mesh, mark, scheme) for mark in marks]
            twice = [rtin.refine(m, np.arange(0, m.n_triangles, 7), scheme) for m in once]
            results.append([bytes_of(m) for m in once + twice])
        assert results[0] == results[1] == results[2]
        for refined in once + twice:
            validity.check(refined)
        assert_is_the_papers(mesh, np.flatnonzero(marks[1]), scheme, once[1])


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_refining_one_target_after_another_reaches_no_farther_than_all_at_once(mesh, scheme, seed):
    """Marks add up: the midpoints for two targets together are those for each."""
    rng = np.random.default_rng(seed)
    one, other = rng.integers(0, mesh.n_triangles, 2)
    new = [
        set(map(tuple, rtin.refine(mesh, targets, scheme).vertices[mesh.n_vertices :].tolist()))
        for targets in ([one], [other], [one, other])
    ]
    assert new[0] | new[1] == new[2]


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_heights_have_no_say_in_the_places(mesh, scheme, seed):
    tall = TriangleMesh(mesh.vertices * [1, 1, -1000] + [0, 0, 9], mesh.triangles)
    targets = meshes.targets_of(mesh, np.random.default_rng(seed))
    one, other = (rtin.refine(m, targets, scheme) for m in (mesh, tall))
    assert one.triangles.tobytes() == other.triangles.tobytes()
    assert one.vertices[:, :2].tobytes() == other.vertices[:, :2].tobytes()


# --- what comes along ---------------------------------------------------------------------------


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_children_inherit_tags(mesh, scheme, seed):
    rng = np.random.default_rng(seed)
    tags = rng.integers(-5, 5, mesh.n_triangles)
    targets = meshes.targets_of(mesh, rng)
    refined = rtin.refine(TriangleMesh(mesh.vertices, mesh.triangles, None, tags), targets, scheme)
    parents = rtin.refine(tagged(mesh), targets, scheme).tags
    assert refined.tags.tolist() == tags[parents].tolist()
    assert refined.tags.dtype == np.int32
    assert rtin.refine(mesh, targets, scheme).tags is None


def test_keeps_the_crs():
    mesh = hand_meshes.in_utm()
    assert rtin.refine(mesh, [3]).crs == mesh.crs
    assert rtin.refine(mesh, [3]).crs is not None


@given(meshes.any_mesh, meshes.schemes, meshes.seeds)
def test_leaves_its_input_alone(mesh, scheme, seed):
    before = bytes_of(tagged(mesh))
    targets = meshes.targets_of(mesh, np.random.default_rng(seed))
    marks = targets.copy()
    refined = rtin.refine(mesh, targets, scheme)
    assert bytes_of(tagged(mesh)) == before
    assert (targets == marks).all()
    assert not np.shares_memory(refined.vertices, mesh.vertices)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_keeps_vertices_that_belong_to_no_triangle(scheme):
    vertices = np.vstack([SQUARE.vertices, [[9, 9, 9], [1, 1, 0], [-7, 1e9, 0], [0, 0, 0]]])
    refined = rtin.refine(TriangleMesh(vertices, SQUARE.triangles), [0], scheme)
    wanted = rtin.refine(SQUARE, [0], scheme)
    assert refined.vertices[:8].tobytes() == vertices.tobytes()
    assert refined.vertices[8:].tobytes() == wanted.vertices[4:].tobytes()
    moved = np.where(wanted.triangles < 4, wanted.triangles, wanted.triangles + 4)
    assert refined.triangles.tolist() == moved.tolist()


@pytest.mark.parametrize("side", [0, 1, 2])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_first_bisects_the_edge_from_vertex_0_to_1_whatever_its_length(scheme, side):
    mesh = TriangleMesh(SQUARE.vertices, np.roll(SQUARE.triangles, side, axis=1))
    for _ in range(3):
        refined = rtin.refine(tagged(mesh), [0], scheme)
        a, b, _ = mesh.triangles[0]
        middle = (mesh.vertices[a] + mesh.vertices[b]) / 2
        assert middle.tolist() in refined.vertices[mesh.n_vertices :].tolist()
        validity.check(refined)
        mesh = refined


# --- a criterion --------------------------------------------------------------------------------


@given(meshes.any_mesh, meshes.schemes, st.sampled_from([0.02, 0.1, 0.7]))
def test_refines_until_a_criterion_is_content(mesh, scheme, share):
    most = share * mesh.signed_areas().max()
    refined = rtin.refine(mesh, lambda mesh: mesh.signed_areas() > most, scheme)
    assert refined.signed_areas().max() <= most
    assert meshes.is_right(refined)
    step_by_step = mesh
    while (large := np.flatnonzero(step_by_step.signed_areas() > most)).size:
        step_by_step = rtin.refine(step_by_step, large, scheme)
    assert bytes_of(refined) == bytes_of(step_by_step)


def test_hands_each_refined_mesh_to_the_criterion():
    seen = []

    def criterion(mesh):
        seen.append(mesh)
        return [0] if len(seen) < 4 else []

    refined = rtin.refine(SQUARE, criterion)
    assert seen[0] is SQUARE
    assert seen[-1] is refined
    assert [m.n_triangles for m in seen] == sorted({m.n_triangles for m in seen})


@pytest.mark.parametrize("answer", [[2], [-1], [0.5], [True], [[0, 1]], None])
def test_checks_what_a_criterion_returns(answer):
    with pytest.raises((IndexError, TypeError, ValueError), match="triangle"):
        rtin.refine(SQUARE, lambda _: answer)


# --- heights ------------------------------------------------------------------------------------


@given(
    terrains.rasters(largest=9, holes=False),
    st.sampled_from(list(meshes.TRANSFORMS)),
    terrains.tolerances,
    meshes.schemes,
    meshes.seeds,
)
def test_new_vertices_get_the_heights_of_a_grid(heights, transform, tolerance, scheme, seed):
    grid = rtin.Grid(heights, meshes.TRANSFORMS[transform])
    mesh = rtin.coarsen(grid, max_error=tolerance)
    mesh = TriangleMesh(mesh.vertices * [1, 1, 0] - [0, 0, 77], mesh.triangles)
    for before, targets, refined in steps(mesh, scheme, seed, 3, heights=grid):
        assert refined.vertices[: before.n_vertices].tobytes() == before.vertices.tobytes()
        new = refined.vertices[before.n_vertices :]
        for (_, _, z), (row, col) in zip(new, grid.places(new[:, :2]), strict=True):
            if row == int(row) and col == int(col):
                assert z == grid.heights[int(row), int(col)]
            else:
                assert abs(z - bilinear(grid.heights, row, col)) < 1e-7
        plain = rtin.refine(before, targets, scheme)
        assert plain.triangles.tobytes() == refined.triangles.tobytes()
        assert plain.vertices[:, :2].tobytes() == refined.vertices[:, :2].tobytes()


def bilinear(heights, row, col):
    top, left = int(row), int(col)
    down, right = row - top, col - left
    bottom, far = int(np.ceil(row)), int(np.ceil(col))
    upper = (1 - right) * heights[top, left] + right * heights[top, far]
    lower = (1 - right) * heights[bottom, left] + right * heights[bottom, far]
    return (1 - down) * upper + down * lower


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_new_vertex_without_a_height_lies_midway(scheme):
    """Outside the raster, and next to a void."""
    heights = np.arange(25.0).reshape(5, 5) ** 2
    heights[2, 2] = np.nan
    grid = rtin.Grid(heights)
    corners = [[-4, 4, 7], [4, 4, 9], [4, -4, 100], [-4, -4, 50]]
    mesh = TriangleMesh.from_triangles(corners, [[0, 1, 2], [0, 2, 3]])
    n_midway, n_lifted = 0, 0
    for _ in range(5):
        everything = np.arange(mesh.n_triangles)
        plain = rtin.refine(mesh, everything, scheme)
        refined = rtin.refine(mesh, everything, scheme, heights=grid)
        for (x, y, z), (_, _, midway) in zip(refined.vertices, plain.vertices, strict=True):
            row, col = -y, x
            near = heights[int(np.floor(row)) : int(np.ceil(row)) + 1,
                           int(np.floor(col)) : int(np.ceil(col)) + 1]  # fmt: skip
            if [x, y] in mesh.vertices[:, :2].tolist():
                continue
            if min(row, col) < 0 or max(row, col) > 4 or np.isnan(near).any():
                assert z == midway
                n_midway += 1
            else:
                assert z == pytest.approx(bilinear(heights, row, col), abs=1e-9)
                n_lifted += 1
        mesh = refined
    assert min(n_midway, n_lifted) > 5


# --- other people's programs --------------------------------------------------------------------
# scikit-fem puts the longest edge between vertices 0 and 2 where one other edge is longer than both
# others. If the other two tie and are longer than that one, nothing is moved, and it bisects the
# shortest edge; so meshes here have no such triangles: places at random, and right isosceles ones.


def scikit_fem_refined(mesh, targets):
    """Refined places by scikit-fem: each triangle as a set of its (x, y)."""
    skfem = pytest.importorskip("skfem")
    theirs = skfem.MeshTri(
        np.ascontiguousarray(mesh.vertices[:, :2].T), np.ascontiguousarray(mesh.triangles.T)
    )
    refined = theirs.refined(np.asarray(targets))
    corners = refined.p.T[refined.t.T].tolist()
    return {frozenset(map(tuple, triangle)) for triangle in corners}


def assert_agrees_with_scikit_fem(mesh, rng, n_steps):
    for _ in range(n_steps):
        targets = np.flatnonzero(rng.random(mesh.n_triangles) < rng.choice([0.05, 0.3]))
        targets = targets if len(targets) else np.array([mesh.n_triangles - 1])
        refined = rtin.refine(mesh, targets, "4T-SS")
        ours = {frozenset(places) for places in set_of_flat_places(refined)}
        assert ours == scikit_fem_refined(mesh, targets)
        mesh = refined


@pytest.mark.parametrize("seed", range(8))
def test_does_what_scikit_fem_does_on_tins(seed):
    rng = np.random.default_rng(seed)
    mesh = meshes.delaunay(rng.random((40, 2)), rng)
    if seed % 2:
        mesh = in_use(meshes.without(mesh, rng.random(mesh.n_triangles) < 0.2))
    assert_agrees_with_scikit_fem(mesh, rng, 5)


def in_use(mesh):
    """Without the vertices that belong to no triangle, which scikit-fem doesn't like."""
    numbers, triangles = np.unique(mesh.triangles, return_inverse=True)
    return TriangleMesh(mesh.vertices[numbers], triangles.reshape(-1, 3))


@pytest.mark.parametrize("seed", range(4))
def test_does_what_scikit_fem_does_on_lattices(seed):
    rng = np.random.default_rng(seed)
    heights = terrains.noise((9, 9), seed)
    mesh = meshes.uniform(4) if seed % 2 else rtin.coarsen(rtin.Grid(heights), max_error=40.0)
    assert_agrees_with_scikit_fem(mesh, rng, 5)


# --- what it does not take ----------------------------------------------------------------------


def first_complaint(mesh):
    """What `validity.check` would say first, but for vertices that belong to no triangle."""
    wrong = [c for c in validity.complaints(mesh) if "belongs to no triangle" not in c]
    return re.sub(r" \(\d+ such\)$", "", wrong[0]) if wrong else None


def assert_refused(mesh, targets=(0,), **options):
    before = bytes_of(mesh)
    with pytest.raises(validity.InvalidMesh) as raised:
        rtin.refine(mesh, targets, **options)
    assert str(raised.value) == first_complaint(mesh)
    assert bytes_of(mesh) == before


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault != "unused vertex"])
def test_says_of_each_fault_what_a_check_says(fault, scheme):
    mesh, (complaint, *_) = FAULTS[fault]
    assert_refused(mesh, scheme=scheme)
    assert_refused(mesh, [], scheme=scheme)
    assert first_complaint(mesh) == complaint


# Three triangles at the edge from 0 to 1, on either side of it, and a fourth.
FAN = [[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, -1, 0], [1, 2, 0], [1, -2, 0]]
SHEETS = [[0, 1, 2], [1, 0, 3], [0, 1, 4], [1, 0, 5]]


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
@pytest.mark.parametrize("turn", [0, 1, 2])
def test_refuses_an_edge_of_three_triangles_in_every_order(order, turn):
    triangles = np.roll([SHEETS[i] for i in order], turn, axis=1)
    assert_refused(TriangleMesh(FAN[:5], triangles))


@pytest.mark.parametrize("order", list(permutations(range(4))), ids=str)
def test_refuses_two_sheets_through_one_edge(order):
    assert_refused(TriangleMesh(FAN, [SHEETS[i] for i in order]))


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_refuses_a_mesh_that_is_there_twice(turn):
    mesh = meshes.uniform(2)
    again = np.roll(mesh.triangles, turn, axis=1)
    assert_refused(TriangleMesh(mesh.vertices, np.r_[mesh.triangles, again]))
    assert_refused(TriangleMesh(mesh.vertices, np.r_[mesh.triangles, again][::-1]))
    assert_refused(TriangleMesh(mesh.vertices, np.repeat(again, 2, axis=0)))
    above = mesh.vertices + np.array([0, 0, 9])
    sheets = np.r_[mesh.triangles, again + mesh.n_vertices]
    assert_refused(TriangleMesh(np.r_[mesh.vertices, above], sheets))


def flipped(mesh, rng):
    triangles = mesh.triangles.copy()
    at = rng.integers(mesh.n_triangles)
    triangles[at] = triangles[at, ::-1]
    return TriangleMesh(mesh.vertices, triangles)


def repeated(mesh, rng):
    again = np.roll(mesh.triangles[rng.integers(mesh.n_triangles)], rng.integers(3))
    return TriangleMesh(mesh.vertices, np.r_[mesh.triangles, [again]])


def torn(mesh, rng):
    """One triangle gets a vertex of its own, at the same place or a little off."""
    triangles, (at, corner) = mesh.triangles.copy(), rng.integers((mesh.n_triangles, 3))
    vertex = mesh.vertices[triangles[at, corner]] + [0, 0, rng.integers(2)]
    triangles[at, corner] = mesh.n_vertices
    return TriangleMesh(np.vstack([mesh.vertices, vertex]), triangles)


def hanging(mesh, rng):
    """One triangle is bisected at one side, its neighbours are not."""
    a, b, c = np.roll(mesh.triangles[(at := rng.integers(mesh.n_triangles))], rng.integers(3))
    middle = (mesh.vertices[a] + mesh.vertices[b]) / 2
    halves = [[c, a, mesh.n_vertices], [b, c, mesh.n_vertices]]
    triangles = np.r_[np.delete(mesh.triangles, at, axis=0), halves]
    return TriangleMesh(np.vstack([mesh.vertices, middle]), triangles)


def flattened(mesh, rng):
    """A vertex is moved into the middle of an edge of its triangle."""
    vertices = mesh.vertices.copy()
    a, b, c = np.roll(mesh.triangles[rng.integers(mesh.n_triangles)], rng.integers(3))
    vertices[c] = (vertices[a] + vertices[b]) / 2
    return TriangleMesh(vertices, mesh.triangles)


def misnamed(mesh, rng):
    triangles, at = mesh.triangles.copy(), rng.integers((mesh.n_triangles, 3))
    triangles[tuple(at)] = rng.integers(mesh.n_vertices)
    return TriangleMesh(mesh.vertices, triangles)


def infinite(mesh, rng):
    vertices, at = mesh.vertices.copy(), (rng.choice(mesh.triangles.ravel()), rng.integers(3))
    vertices[at] = rng.choice([np.nan, np.inf, -np.inf])
    return TriangleMesh(vertices, mesh.triangles)


def crowded(mesh, rng):
    """A third triangle at an edge, or one more at the boundary that may lie over others."""
    a, b = rng.permutation(np.roll(mesh.triangles[rng.integers(mesh.n_triangles)], 1)[:2])
    place = mesh.vertices[rng.integers(mesh.n_vertices)] + rng.random(3)
    triangles = np.r_[mesh.triangles, [[a, b, mesh.n_vertices]]]
    return TriangleMesh(np.vstack([mesh.vertices, place]), triangles)


BREAKS = [flipped, repeated, torn, hanging, flattened, misnamed, infinite, crowded]


@pytest.mark.parametrize("broken", BREAKS, ids=lambda function: function.__name__)
@given(mesh=meshes.any_mesh, scheme=meshes.schemes, seed=meshes.seeds)
def test_refuses_what_a_check_refuses_and_nothing_else(broken, mesh, scheme, seed):
    rng = np.random.default_rng(seed)
    mesh = in_use(meshes.renumbered(broken(mesh, rng), rng))
    if first_complaint(mesh) is None:
        assert meshes.is_right(rtin.refine(mesh, [0], scheme))
    else:
        assert_refused(mesh, scheme=scheme)


def test_a_fault_is_found_in_every_band_of_a_large_mesh(monkeypatch):
    mesh = meshes.uniform(32)
    for n_threads in ("1", "2"):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        for at in (0, 255, 256, 1000, mesh.n_triangles - 1):
            triangles = mesh.triangles.copy()
            triangles[at] = triangles[at, ::-1]
            assert_refused(TriangleMesh(mesh.vertices, triangles))
            third = np.r_[mesh.triangles, mesh.triangles[at : at + 1, ::-1]]
            assert_refused(TriangleMesh(mesh.vertices, third))


@pytest.mark.parametrize("offset", [0.0, 1e3, 5e6])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_says_when_a_triangle_is_too_small_to_split(scheme, offset):
    """One triangle, again and again, at a place that float64 has to round."""
    places = np.array([[0, 0, 1], [1, 0.1, 2], [0.1, 1, 3]]) / 3 + [offset, offset, 0]
    mesh, error = refined_until_refused(TriangleMesh.from_triangles(places, [[0, 1, 2]]), scheme)
    validity.check(mesh)
    assert re.fullmatch("a triangle is too small or too thin to be split.*", str(error))
    named = re.findall(r"\(([^,()]*), ([^,()]*)\)", str(error))
    corners = [{place[:2] for place in triangle} for triangle in with_places(mesh)]
    assert {tuple(map(float, place)) for place in named} in corners
    assert type(error) is ValueError


def refined_until_refused(mesh, scheme):
    for _ in range(200):
        before = bytes_of(mesh)
        try:
            mesh = rtin.refine(mesh, [mesh.n_triangles // 2], scheme)
        except ValueError as error:
            assert bytes_of(mesh) == before
            return mesh, error
    raise AssertionError("float64 has no end")


@pytest.mark.parametrize("between", [0, 3000])
def test_of_two_triangles_that_are_too_small_the_first_is_named(between):
    """In one band of triangles, and in two."""
    places = np.array([[0, 0, 1], [1, 0.1, 2], [0.1, 1, 3]]) / 3 + [5e6, 5e6, 0]
    mesh, _ = refined_until_refused(TriangleMesh.from_triangles(places, [[0, 1, 2]]), "4T-LE")
    target = mesh.n_triangles // 2
    for turn, sign in ((1, ""), (-1, "-")):  # half a turn rounds nothing
        one, other = mesh.vertices * [turn, turn, 1], mesh.vertices * [-turn, -turn, 1]
        far = meshes.strip(max(between, 1), np.random.default_rng(0))
        starts = np.cumsum([0, len(one), len(far.vertices)])
        both = TriangleMesh(
            np.vstack([one, far.vertices, other]),
            np.vstack([mesh.triangles, far.triangles + starts[1], mesh.triangles + starts[2]]),
        )
        with pytest.raises(ValueError, match=rf"split in float64: \({sign}5\d+\.\d+, {sign}5"):
            rtin.refine(both, [target, mesh.n_triangles + far.n_triangles + target])


def test_refuses_more_triangles_than_can_be_numbered(monkeypatch):
    monkeypatch.setattr("rtin._adjacency.MOST_TRIANGLES", 9)
    assert rtin.refine(SQUARE, [0, 1]).n_triangles == 8
    with pytest.raises(ValueError, match=r"at most 9 triangles .* would have 32; mark fewer"):
        rtin.refine(rtin.refine(SQUARE, [0, 1]), range(8))


WRONG = {
    "no such triangle": (
        {"targets": [0, 2]},
        IndexError,
        "there are 2 .*; got 2",
    ),
    "negative": (
        {"targets": [0, -1]},
        IndexError,
        "there are 2 .*; got -1",
    ),
    "very large": ({"targets": [2**63]}, IndexError, f"got {2**63}"),
    "fractions": ({"targets": [0.0, 1.0]}, TypeError, r"wanted, got .* float64 with shape \(2,\)"),
    "text": ({"targets": ["0"]}, TypeError, "wanted, got an array of <U1"),
    "nothing": ({"targets": None}, TypeError, "wanted, got NoneType"),
    "a set": ({"targets": {0, 1}}, TypeError, "wanted, got set"),
    "a number": ({"targets": 1}, ValueError, r"one dimension, got shape \(\)"),
    "two dimensions": ({"targets": [[0, 1]]}, ValueError, r"one dimension, got shape \(1, 2\)"),
    "two-dimensional mask": ({"targets": [[True, False]]}, TypeError, "bool with shape"),
    "short mask": ({"targets": [True]}, ValueError, "a value for each of 2, got 1"),
    "long mask": ({"targets": [True] * 3}, ValueError, "a value for each of 2, got 3"),
    "empty mask": ({"targets": np.zeros(0, bool)}, ValueError, "for each of 2, got 0"),
    "scheme": ({"scheme": "4T"}, ValueError, "one of 4T-LE, 4T-SS, bisection, got '4T'"),
    "no scheme": ({"scheme": None}, ValueError, "one of 4T-LE, .* got None"),
    "no mesh": ({"mesh": SQUARE.vertices}, TypeError, "a TriangleMesh is wanted, got ndarray"),
    "heights": ({"heights": np.ones((3, 3))}, TypeError, "a Grid is wanted, got ndarray"),
    "a height": ({"heights": 0.0}, TypeError, "a Grid is wanted, got float"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_says_what_was_wanted_and_what_came(wrong):
    options, error, message = WRONG[wrong]
    with pytest.raises(error, match=message) as raised:
        rtin.refine(**{"mesh": SQUARE, "targets": [0]} | options)
    assert "\n" not in str(raised.value)


def test_a_vertex_that_is_not_finite_is_refused_even_where_no_triangle_has_it():
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0]]
    mesh = TriangleMesh.from_triangles(points, [[0, 1, 2]])
    with pytest.raises(validity.InvalidMesh, match="vertex 3 has a coordinate that is not finite"):
        rtin.refine(mesh, [0])


def test_says_what_came_instead_of_numbers():
    mesh = TriangleMesh.from_triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(TypeError, match="a boolean for each are wanted, got set"):
        rtin.refine(mesh, {0})
    with pytest.raises(TypeError, match="a boolean for each are wanted, got function"):
        rtin.AdaptiveMesh(mesh).refine(lambda mesh: [0])
    with pytest.raises(ValueError, match=r"scheme must be one of .*, got \['4T-LE'\]"):
        rtin.refine(mesh, [0], ["4T-LE"])
