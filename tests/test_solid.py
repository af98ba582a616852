import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hand_meshes import bumpy, in_utm, touching_at_a_point, with_hole
from rtin.io.meshes import write_mesh
from rtin.io.solid import close
from rtin.mesh import TriangleMesh

SHAPES = {
    "plain": bumpy,
    "with a hole": with_hole,
    "two parts that touch at a point": touching_at_a_point,
    "one triangle": lambda: TriangleMesh([[0, 0, 1], [1, 0, 2], [0, 1, 3]], [[1, 2, 0]]),
}


def independent(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)


def assert_closed(solid):
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0


def reloaded_from_stl(mesh, path, **options):
    write_mesh(mesh, path, **options)
    return trimesh.load_mesh(path)


def volume_below(mesh, bottom):
    heights = mesh.vertices[mesh.triangles, 2].mean(axis=1) - bottom
    return float((mesh.signed_areas() * heights).sum())


@pytest.mark.parametrize("name", SHAPES)
def test_is_closed_in_memory(name):
    assert_closed(independent(close(SHAPES[name](), 10.0)))


@pytest.mark.parametrize("name", SHAPES)
def test_is_closed_after_a_round_trip_through_stl(name, tmp_path):
    assert_closed(reloaded_from_stl(SHAPES[name](), tmp_path / "solid.stl", base=10.0))


def test_is_closed_after_a_round_trip_through_stl_at_utm_coordinates(tmp_path):
    assert_closed(reloaded_from_stl(in_utm(), tmp_path / "solid.stl", base=0.5, z_scale=3.0))


@pytest.mark.parametrize("shape", [bumpy, with_hole])
def test_has_the_volume_between_terrain_and_bottom(shape):
    mesh = shape()
    bottom = mesh.vertices[:, 2].min() - 10.0
    solid = independent(close(mesh, 10.0))
    assert solid.volume == pytest.approx(volume_below(mesh, bottom))
    assert solid.bounds[0, 2] == pytest.approx(bottom)


def test_keeps_the_terrain_first_and_the_crs():
    mesh = in_utm()
    solid = close(mesh, 5.0)
    np.testing.assert_array_equal(solid.vertices[: mesh.n_vertices], mesh.vertices)
    np.testing.assert_array_equal(solid.triangles[: mesh.n_triangles], mesh.triangles)
    assert solid.crs == mesh.crs


def test_counts_two_triangles_for_each_boundary_edge():
    mesh = with_hole()
    n_boundary_edges = 2 * (6 + 8) + 2 * (2 + 3)
    assert close(mesh, 1.0).n_triangles == 2 * mesh.n_triangles + 2 * n_boundary_edges


def test_bottom_counts_only_vertices_of_triangles():
    mesh = TriangleMesh([[0, 0, 5], [1, 0, 5], [0, 1, 5], [9, 9, -99]], [[1, 2, 0]])
    assert independent(close(mesh, 1.0)).bounds[0, 2] == 4.0


def test_pulls_each_part_from_a_pinch_into_itself():
    mesh = touching_at_a_point()
    pinch = 3 * 9 + 4
    solid = close(mesh, 10.0)
    terrain = solid.triangles[: mesh.n_triangles]
    for copy in (pinch, mesh.n_vertices):
        (own,) = terrain[(terrain == copy).any(axis=1)]
        inwards = solid.vertices[own[own != copy]].mean(axis=0) - mesh.vertices[pinch]
        move = solid.vertices[copy] - mesh.vertices[pinch]
        # The diagonal of a cell of 30 m is 30 / √2 from the cell's corner.
        inwards = inwards[:2] / np.linalg.norm(inwards[:2])
        np.testing.assert_allclose(move[:2], 0.01 * 30.0 / np.sqrt(2.0) * inwards)
        assert move[2] == 0.0
    others = np.delete(np.arange(mesh.n_vertices), pinch)
    np.testing.assert_array_equal(solid.vertices[others], mesh.vertices[others])


@settings(derandomize=True, deadline=None, max_examples=150)
@given(arrays(bool, (5, 6)).filter(np.any))
def test_is_closed_whatever_cells_are_missing(cells):
    solid = close(bumpy(6, 7, cells=cells), 2.0)
    top = slice(0, 2 * int(cells.sum()))
    assert (TriangleMesh(solid.vertices, solid.triangles[top]).signed_areas() > 0).all()
    rounded = independent(solid)
    rounded.vertices = np.float32(rounded.vertices)
    rounded.merge_vertices()
    assert_closed(rounded)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(arrays(bool, 8).filter(lambda wedges: 0 < wedges.sum() < 8), st.floats(0.0, 6.0))
def test_is_closed_whatever_wedges_around_a_vertex_are_missing(wedges, turn):
    angles = turn + np.arange(8) * np.pi / 4
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.arange(8.0)])
    spokes = np.flatnonzero(wedges)
    triangles = np.column_stack([1 + spokes, 1 + (spokes + 1) % 8, np.zeros_like(spokes)])
    solid = close(TriangleMesh(np.vstack([[0.0, 0.0, 4.0], ring]), triangles), 1.0)
    assert_closed(independent(solid))
    assert (TriangleMesh(solid.vertices, solid.triangles[: len(spokes)]).signed_areas() > 0).all()


@pytest.mark.parametrize("base", [0.0, -1.0, np.nan, np.inf])
def test_refuses_a_base_that_is_not_more_than_zero(base):
    with pytest.raises(ValueError, match="base must be more than zero"):
        close(bumpy(), base)


def test_refuses_what_is_no_mesh_or_no_number():
    with pytest.raises(TypeError, match=r"^a TriangleMesh is wanted, got ndarray$"):
        close(bumpy().vertices, 1.0)
    with pytest.raises(TypeError, match=r"^base must be a number, got '2'$"):
        close(bumpy(), "2")


def test_refuses_a_mesh_without_triangles():
    with pytest.raises(ValueError, match="without any"):
        close(TriangleMesh([[0, 0, 0]], np.empty((0, 3), int)), 1.0)


def test_refuses_triangles_seen_from_below():
    mesh = bumpy()
    with pytest.raises(ValueError, match="counter-clockwise"):
        close(TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1]), 1.0)


def test_refuses_three_triangles_at_an_edge():
    mesh = bumpy()
    twice = np.concatenate([mesh.triangles, mesh.triangles[:1]])
    with pytest.raises(ValueError, match="at most two triangles"):
        close(TriangleMesh(mesh.vertices, twice), 1.0)
