"""Meshes to and from the classes of other libraries, in memory."""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin.mesh import TriangleMesh, require_mesh

if TYPE_CHECKING:
    import skfem
    from matplotlib.tri import Triangulation

__all__ = ["from_skfem", "from_triangulation", "to_skfem", "to_triangulation"]

_WHOLE_NUMBER = re.compile(r"[+-]?\d+")


def to_skfem(mesh: TriangleMesh) -> skfem.MeshTri:
    """Return ``mesh``, seen from above, as a scikit-fem mesh.

    Vertex i is column i of ``.p``, in the units of the CRS, and triangle i is column i of ``.t``,
    whose vertex numbers ascend in each column, as scikit-fem's elements need them. So an array
    (n,) of the vertices, such as the heights ``mesh.vertices[:, 2]``, is a P1 function on it.

    Parameters
    ----------
    mesh : TriangleMesh
        The triangles with tag t are the subdomain named ``str(t)``.

    Returns
    -------
    skfem.MeshTri
        Without the heights and the CRS.

    Raises
    ------
    TypeError
        If ``mesh`` is not a TriangleMesh.
    ImportError
        If scikit-fem is not installed.
    """
    require_mesh(mesh)
    library = _require("skfem", "scikit-fem")
    shape = library.MeshTri(mesh.vertices[:, :2].T.copy(), mesh.triangles.T.copy())
    if mesh.tags is None:
        return shape
    tags = np.unique(mesh.tags).tolist()
    return shape.with_subdomains({str(tag): np.flatnonzero(mesh.tags == tag) for tag in tags})


def from_skfem(
    skfem_mesh: skfem.MeshTri,
    z: ArrayLike | None = None,
    crs: Any = None,  # noqa: ANN401
) -> TriangleMesh:
    """Return a scikit-fem mesh as a TriangleMesh, its vertices and triangles in the same order.

    Each triangle is put in the order that ``TriangleMesh.from_triangles`` describes.

    Parameters
    ----------
    skfem_mesh : skfem.MeshTri
        Its subdomains become tags. A name that is a whole number is the tag; the other names, in
        sorted order, get the numbers after the largest of these, from 1 on where there are none.
        Triangles in no subdomain get 0.
    z : array_like of float64, shape (n,), optional
        The heights of the vertices; zero where left out.
    crs : pyproj.CRS or anything pyproj takes, optional

    Raises
    ------
    ValueError
        If z has another shape, or a triangle is in more than one subdomain.
    TypeError
        If ``skfem_mesh`` is no mesh of straight triangles.
    ImportError
        If scikit-fem is not installed.
    """
    library = _require("skfem", "scikit-fem")
    if type(skfem_mesh) is not library.MeshTri:
        raise TypeError(
            f"a skfem.MeshTri is wanted, got {type(skfem_mesh).__name__}; "
            "quads have .to_meshtri(), and MeshTri.from_mesh straightens curved triangles"
        )
    places, triangles = skfem_mesh.p.T, skfem_mesh.t.T
    tags = None
    if skfem_mesh.subdomains:
        tags = _tags_of(skfem_mesh.subdomains, len(triangles))
    return TriangleMesh.from_triangles(_raised(places, z), triangles, crs, tags)


def to_triangulation(mesh: TriangleMesh) -> Triangulation:
    """Return ``mesh``, seen from above, as a matplotlib triangulation.

    Its vertices and triangles are those of the mesh, in the same order; heights, tags and the CRS
    are not in it. ``axes.tricontour(triangulation, mesh.vertices[:, 2])`` draws contours.

    Raises
    ------
    TypeError
        If ``mesh`` is not a TriangleMesh.
    """
    from matplotlib.tri import Triangulation

    x, y, _ = require_mesh(mesh).vertices.T
    return Triangulation(x, y, mesh.triangles)


def from_triangulation(
    triangulation: Triangulation,
    z: ArrayLike | None = None,
    crs: Any = None,  # noqa: ANN401
) -> TriangleMesh:
    """Return a matplotlib triangulation as a TriangleMesh, its vertices in the same order.

    Triangles that are masked are left out, the others keep their order; each is put in the order
    that ``TriangleMesh.from_triangles`` describes.

    Parameters
    ----------
    triangulation : matplotlib.tri.Triangulation
    z : array_like of float64, shape (n,), optional
        The heights of the vertices; zero where left out.
    crs : pyproj.CRS or anything pyproj takes, optional

    Raises
    ------
    ValueError
        If z has another shape.
    TypeError
        If ``triangulation`` is no matplotlib triangulation.
    """
    from matplotlib.tri import Triangulation

    if not isinstance(triangulation, Triangulation):
        kind = type(triangulation).__name__
        raise TypeError(f"a matplotlib.tri.Triangulation is wanted, got {kind}")
    places = np.column_stack([triangulation.x, triangulation.y])
    triangles = triangulation.get_masked_triangles()
    return TriangleMesh.from_triangles(_raised(places, z), triangles, crs)


def _raised(places: NDArray[np.float64], z: ArrayLike | None) -> NDArray[np.float64]:
    """Return vertices, shape (n, 3), above ``places``, shape (n, 2)."""
    heights = np.zeros(len(places)) if z is None else np.asarray(z, dtype=np.float64)
    if heights.shape != (len(places),):
        raise ValueError(f"z must have shape ({len(places)},), got {heights.shape}")
    return np.column_stack([places, heights])


def _tags_of(subdomains: Mapping[str, NDArray[Any]], n_triangles: int) -> NDArray[np.int64]:
    """Return the tag of each triangle, as ``from_skfem`` says."""
    tags = np.zeros(n_triangles, dtype=np.int64)
    owner = np.full(n_triangles, -1)
    names = sorted(subdomains)
    for number, (name, tag) in enumerate(zip(names, _numbers_of(names), strict=True)):
        triangles = subdomains[name]
        taken = np.asarray(triangles)[owner[triangles] >= 0]
        if taken.size:
            other = names[owner[taken[0]]]
            raise ValueError(
                "each triangle must be in one subdomain at most, "
                f"but triangle {taken[0]} is in {other!r} and {name!r}"
            )
        tags[triangles], owner[triangles] = tag, number
    return tags


def _numbers_of(names: list[str]) -> list[int]:
    whole = {name: int(name) for name in names if _WHOLE_NUMBER.fullmatch(name)}
    following = max([0, *whole.values()]) + 1
    others = [name for name in names if name not in whole]
    numbers = whole | {name: following + i for i, name in enumerate(others)}
    return [numbers[name] for name in names]


def _require(module: str, package: str) -> Any:  # noqa: ANN401
    """Return the module, or raise an ImportError that says how to install it."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise ImportError(
            f'{package} is wanted, which is not installed; pip install "rtin[fem]"'
        ) from None
