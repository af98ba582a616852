"""Meshes to and from scikit-fem and matplotlib."""

import re
import sys

import matplotlib.tri
import numpy as np
import pytest
import skfem
from skfem.helpers import dot, grad

import rtin
from hand_meshes import bumpy, in_utm, with_hole
from rtin import validity
from rtin.mesh import TriangleMesh


def tagged(mesh, tags):
    return TriangleMesh(mesh.vertices, mesh.triangles, mesh.crs, np.resize(tags, mesh.n_triangles))


def same_bytes(one, other):
    names = ("vertices", "triangles", "tags")
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in names)


# scikit-fem


@pytest.mark.parametrize("shape", [bumpy, with_hole, in_utm])
def test_a_mesh_comes_back_from_scikit_fem(shape):
    mesh = tagged(shape(), [5, -1, 0, 7])
    back = rtin.from_skfem(rtin.to_skfem(mesh), mesh.vertices[:, 2], mesh.crs)
    assert same_bytes(back, mesh)
    assert back.crs == mesh.crs


def test_scikit_fem_numbers_vertices_and_triangles_as_we_do():
    mesh = tagged(in_utm(), [5, 1])
    found = rtin.to_skfem(mesh)
    np.testing.assert_array_equal(found.p.T, mesh.vertices[:, :2])
    np.testing.assert_array_equal(found.t.T, np.sort(mesh.triangles, axis=1))
    assert sorted(found.subdomains) == ["1", "5"]
    np.testing.assert_array_equal(found.subdomains["5"], np.flatnonzero(mesh.tags == 5))


def test_heights_are_a_linear_function_in_scikit_fem():
    heights = np.add.outer(2.0 * np.arange(7), 3.0 * np.arange(9))  # a plane
    mesh = tagged(bumpy(heights=heights, step=1.0), [1])
    basis = skfem.Basis(rtin.to_skfem(mesh), skfem.ElementTriP1())
    steepness = skfem.Functional(lambda w: dot(grad(w["z"]), grad(w["z"])))
    slopes = steepness.assemble(basis, z=basis.interpolate(mesh.vertices[:, 2]))
    assert slopes == pytest.approx(48.0 * (2.0**2 + 3.0**2))


def test_a_mesh_without_tags_has_no_subdomains():
    found = rtin.to_skfem(bumpy())
    assert not found.subdomains
    assert rtin.from_skfem(found).tags is None


def test_a_mesh_of_scikit_fem_is_put_into_our_order_at_height_zero():
    mesh = rtin.from_skfem(skfem.MeshTri().refined(2))
    validity.check(mesh)
    assert not mesh.vertices[:, 2].any()
    assert (mesh.n_triangles, mesh.crs) == (32, None)
    ends = mesh.vertices[mesh.triangles]
    lengths = np.linalg.norm(np.roll(ends, -1, axis=1) - ends, axis=2)
    assert (lengths.argmax(axis=1) == 0).all()


def test_names_of_subdomains_become_numbers():
    names = {"-3": [0], "12": [1], "meadow": [2], "lake": [3, 4]}
    found = (
        skfem.MeshTri()
        .refined(1)
        .with_subdomains({name: np.array(triangles) for name, triangles in names.items()})
    )
    assert rtin.from_skfem(found).tags.tolist() == [-3, 12, 14, 13, 13, 0, 0, 0]


def test_names_alone_are_numbered_from_one():
    found = skfem.MeshTri().with_subdomains({"b": np.array([0]), "a": np.array([1])})
    assert rtin.from_skfem(found).tags.tolist() == [2, 1]


def test_subdomains_that_overlap_are_refused():
    both = {"left": np.array([0, 1]), "right": np.array([1])}
    message = r"^each triangle must be in one .*, but triangle 1 is in 'left' and 'right'$"
    with pytest.raises(ValueError, match=message):
        rtin.from_skfem(skfem.MeshTri().with_subdomains(both))


@pytest.mark.parametrize("other", [skfem.MeshQuad(), skfem.MeshTri2(), bumpy(), None])
def test_other_meshes_than_of_straight_triangles_are_refused(other):
    message = f"^a skfem.MeshTri is wanted, got {type(other).__name__}; "
    with pytest.raises(TypeError, match=message):
        rtin.from_skfem(other)


def test_without_scikit_fem_the_command_to_install_it_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "skfem", None)
    for convert in (rtin.to_skfem, rtin.from_skfem):
        with pytest.raises(ImportError, match=re.escape('pip install "rtin[fem]"')):
            convert(bumpy())


# matplotlib


def test_a_mesh_comes_back_from_matplotlib():
    mesh = in_utm()
    back = rtin.from_triangulation(rtin.to_triangulation(mesh), mesh.vertices[:, 2], mesh.crs)
    assert back.vertices.tobytes() == mesh.vertices.tobytes()
    assert back.triangles.tobytes() == mesh.triangles.tobytes()
    assert (back.crs, back.tags) == (mesh.crs, None)


def test_matplotlib_interpolates_between_the_vertices():
    heights = np.add.outer(2.0 * np.arange(7), 3.0 * np.arange(9))
    mesh = bumpy(heights=heights, step=1.0)
    found = rtin.to_triangulation(mesh)
    height = matplotlib.tri.LinearTriInterpolator(found, mesh.vertices[:, 2])
    assert float(height(2.25, -1.5)) == pytest.approx(2.0 * 1.5 + 3.0 * 2.25)


def test_masked_triangles_are_left_out():
    mesh = bumpy()
    masked = np.arange(mesh.n_triangles) % 3 == 0
    found = rtin.to_triangulation(mesh)
    found.set_mask(masked)
    np.testing.assert_array_equal(rtin.from_triangulation(found).triangles, mesh.triangles[~masked])


def test_a_delaunay_triangulation_is_put_into_our_order():
    x, y = np.random.default_rng(1).random((2, 50))
    mesh = rtin.from_triangulation(matplotlib.tri.Triangulation(x, y), x + y)
    validity.check(mesh)
    np.testing.assert_array_equal(mesh.vertices, np.column_stack([x, y, x + y]))


# Both


@pytest.mark.parametrize("z", [[1.0, 2.0], 5.0, np.zeros((63, 1))])
def test_heights_of_another_shape_are_refused(z):
    message = re.escape(f"z must have shape (63,), got {np.shape(z)}")
    with pytest.raises(ValueError, match=f"^{message}$"):
        rtin.from_skfem(rtin.to_skfem(bumpy()), z)
    with pytest.raises(ValueError, match=f"^{message}$"):
        rtin.from_triangulation(rtin.to_triangulation(bumpy()), z)


def test_what_is_of_another_kind_is_refused():
    for convert in (rtin.to_skfem, rtin.to_triangulation):
        with pytest.raises(TypeError, match=r"^a TriangleMesh is wanted, got str$"):
            convert("mesh")
    with pytest.raises(TypeError, match=r"^a matplotlib.tri.Triangulation is wanted, got str$"):
        rtin.from_triangulation("mesh")
