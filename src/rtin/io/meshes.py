"""Meshes to and from the formats of 3-D programs."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin._atomic import require_place, write_bytes
from rtin._number import as_positive
from rtin.io import _gltf, _gmsh, _polygons, _sms, _trimesh, _vtk, _xdmf, html
from rtin.io._cells import FileMesh
from rtin.io._placement import PlacedMesh, Placement, place, placement
from rtin.mesh import TriangleMesh, require_mesh

__all__ = [
    "Placement",
    "is_mesh_path",
    "page_of",
    "placement_of",
    "read_mesh",
    "require_shape",
    "require_writable",
    "write_mesh",
]

ENCODERS: dict[str, Callable[[PlacedMesh], bytes]] = {
    ".glb": _gltf.glb,
    ".obj": _polygons.obj,
    ".ply": _polygons.ply,
    ".stl": _polygons.stl,
    ".vtu": _vtk.vtu,
    ".vtp": _vtk.vtp,
    ".msh": _gmsh.msh,
    ".xdmf": _xdmf.xdmf,
    ".2dm": _sms.sms,
    ".html": html.page,
}
_IN_32_BITS = (".glb", ".stl", ".html")
# A third of what float32 holds, so that differences fit too.
_LARGEST_32_BIT = 1e38
_DECODERS: dict[str, Callable[[Path], FileMesh]] = {
    ".glb": _trimesh.read,
    ".obj": _trimesh.read,
    ".ply": _trimesh.read,
    ".stl": _trimesh.read,
    ".vtu": _vtk.read,
    ".vtp": _vtk.read,
    ".msh": _gmsh.read,
    ".xdmf": _xdmf.read,
    ".2dm": _sms.read,
}


def write_mesh(
    mesh: TriangleMesh,
    path: str | os.PathLike[str],
    *,
    z_scale: float = 1.0,
    base: float | None = None,
    keep_degrees: bool = False,
) -> None:
    """Write ``mesh`` to a file whose extension names the format.

    ========  =====================================================================================
    .glb      Binary glTF: y up, tinted by height, with normals and texture coordinates. 32-bit
              numbers around a node at the middle of the mesh: x and y are rounded by at most
              extent / 3e7 (1 mm at 30 km). Float32 heights stay as they are at ``z_scale=1``;
              float64 ones are rounded by at most z / 1.6e7.
    .ply      Binary, 64-bit: nothing is rounded.
    .vtu      VTK unstructured grid, .vtp VTK PolyData, 64-bit: nothing is rounded. They need
              PyVista: ``pip install "rtin[vtk]"``. The tags are the cell data "tag".
    .msh      Gmsh, version 2.2, text as .obj is. The tags are the physical groups; Gmsh takes 0 for
              no group and a negative number for a positive one.
    .xdmf     XDMF for FEniCS and ParaView, one text file as .obj is. The tags are the cell data
              "tag".
    .2dm      SMS and QGIS, text as .obj is. The tags are the materials.
    .obj      Text, with as many digits as reading every number back exactly takes.
    .stl      Binary, 32-bit: rounded as .glb is. x and y count from the middle of the mesh; where
              that is in the world is lost, as is the CRS.
    .html     A page to turn the terrain in, for a browser without a network; not to be read back.
    ========  =====================================================================================

    A mesh whose CRS is geographic is scaled to metres around its middle, so that heights and widths
    have one unit; any other CRS keeps its x and y in all but .stl and .html. All but these two
    store the CRS and what undoes shift and scale, and ``read_mesh`` gives back the mesh as it was.
    ``placement_of`` says what is done. The other formats than those above do not store tags. A mesh
    without tags has 1 everywhere in .msh and .2dm, and none again when ``read_mesh`` reads it.

    In a GLB, u runs from west to east and v from north to south, 0 to 1 over the vertices' bounds,
    so a north-up picture of that extent drapes as it should. Viewers multiply a texture by the
    tint: remove the attribute COLOR_0 when you add one.

    Parameters
    ----------
    mesh : TriangleMesh
    path : str or path-like
        The file is written whole or not at all; one that is there already is replaced.
    z_scale : float
        What heights are multiplied by; more than zero.
    base : float, optional
        Close the terrain to a solid with walls and a flat bottom, this far below the lowest
        triangle corner as written (so not multiplied by ``z_scale``); more than zero. See
        ``rtin.io.solid.close``.
    keep_degrees : bool
        Leave x and y of a geographic CRS in degrees.

    Raises
    ------
    ValueError
        If the extension is unknown, the mesh has no triangle or a vertex that is not finite,
        ``z_scale`` or ``base`` is out of range or makes numbers that are too large for the format,
        or no solid can be made.
    TypeError
        If ``mesh`` is not a TriangleMesh, or ``z_scale`` or ``base`` not a number.
    ImportError
        If the format needs PyVista and that is not installed.
    OSError
        If the file cannot be written. What was there before is still there.
    """
    require_shape(mesh)
    suffix = _known_suffix(path, ENCODERS)
    placed = placement_of(mesh, path, z_scale=z_scale, keep_degrees=keep_degrees)
    write_bytes(path, ENCODERS[suffix](_shape(mesh, placed, base, suffix)))


def page_of(mesh: TriangleMesh, *, z_scale: float = 1.0, note: str = "") -> bytes:
    """Return the page that ``write_mesh`` writes to .html, with a note after its counts.

    Raises ValueError and TypeError as ``write_mesh`` does.
    """
    require_shape(mesh)
    placed = placement_of(mesh, "a.html", z_scale=z_scale)
    return html.page(_shape(mesh, placed, None, ".html"), note)


def placement_of(
    mesh: TriangleMesh,
    path: str | os.PathLike[str],
    *,
    z_scale: float = 1.0,
    keep_degrees: bool = False,
) -> Placement:
    """Return how ``write_mesh`` with the same arguments shifts and scales ``mesh``.

    Of ``path`` only the extension counts: .stl is placed differently from all the others.

    Returns
    -------
    Placement
        ``.origin`` and ``.scale``: file = (world - origin) * scale. ``.note`` is one line about it
        for people, such as "x and y scaled from degrees to metres around 36.59 N 84.25 W", and
        empty where x and y stay as they are.

    Raises
    ------
    ValueError
        If the extension of ``path`` is unknown or ``z_scale`` not more than zero.
    TypeError
        If ``mesh`` is not a TriangleMesh or ``z_scale`` not a number.
    """
    require_mesh(mesh)
    z_scale = as_positive("z_scale", z_scale)
    centred = _known_suffix(path, ENCODERS) == ".stl"
    return placement(mesh, z_scale=z_scale, keep_degrees=keep_degrees, centred=centred)


def require_writable(path: str | os.PathLike[str]) -> None:
    """Raise now what ``write_mesh`` would raise because of ``path``, before the work is done.

    Raises
    ------
    ValueError
        If the extension is unknown.
    ImportError
        If the format needs PyVista and that is not installed.
    OSError
        If the folder does not exist or may not be written to, or ``path`` is a folder.
    """
    if _known_suffix(path, ENCODERS).startswith(".vt"):
        _vtk.require_pyvista()
    require_place(path)


def is_mesh_path(path: str | os.PathLike[str]) -> bool:
    """Return whether ``read_mesh`` knows the extension of ``path``."""
    return Path(path).suffix.lower() in _DECODERS


def read_mesh(path: str | os.PathLike[str]) -> TriangleMesh:
    """Return the mesh in a .glb, .obj, .ply, .stl, .vtu, .vtp, .msh, .xdmf or .2dm file.

    A file that ``write_mesh`` wrote (but for .stl) gives back vertices in the world, triangles in
    the same order, and the CRS; a solid comes back with its walls and bottom. The triangles of any
    other file, or of one that another program has changed, are taken for a terrain: z up (y up in
    .glb) or zero where points have x and y only, vertices at the same place merged into the first
    of them, polygons cut into triangles, several meshes put together, and each triangle turned
    counter-clockwise from above with its longest edge first.

    Of finite elements, points and lines are passed over. Those of second order are cut at all
    their nodes, a triangle into four, so that every node keeps its height.

    Tags come from the cell data "tag", "cell_tags", "gmsh:physical", "medit:ref", "material",
    "MaterialIDs", "material_id" or "gmsh:geometrical" of .vtu, .vtp and .xdmf, the first that has a
    whole number of 32 bits for each cell; from the physical groups of .msh or, where no triangle
    has one, from its surfaces; and from the materials of .2dm.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    OSError
        If it cannot be read as what its extension says, or has cells with a volume.
    ValueError
        If the extension is unknown or the file holds no triangle.
    ImportError
        If .vtu or .vtp needs PyVista, or .xdmf meshio and h5py, and that is not installed.
    """
    suffix = _known_suffix(path, _DECODERS)
    file = Path(path)
    with file.open("rb"):
        pass
    try:
        with np.errstate(all="ignore"):  # a damaged file holds infinite vertices too
            mesh = _as_mesh(_DECODERS[suffix](file))
    except ImportError:
        raise
    except Exception as error:  # what a parser raises on a broken file is anything at all
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise OSError(f"cannot read {path} as {suffix[1:].upper()}: {reason}") from error
    if mesh.n_triangles == 0:
        raise ValueError(f"a mesh is wanted, but {path} holds no triangle, or is broken")
    return mesh


def _as_mesh(found: FileMesh) -> TriangleMesh:
    points, triangles, stored, tags = found
    if stored is None:
        return TriangleMesh.from_triangles(*_merged(points, triangles), tags=tags)
    placed = Placement.from_dict(stored)
    if (stored.get("vertices"), stored.get("triangles")) == (len(points), len(triangles)):
        return TriangleMesh(placed.to_world(points), triangles, placed.crs, tags)
    points, triangles = _merged(points, triangles)
    return TriangleMesh.from_triangles(placed.to_world(points), triangles, placed.crs, tags)


def _merged(
    points: NDArray[np.float64], triangles: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.float64], NDArray[np.integer[Any]]]:
    """Return vertices without repetition, in order of first appearance, and the new triangles."""
    order = np.lexsort(points.T)
    differs = np.any(points[order[1:]] != points[order[:-1]], axis=1)
    groups = np.concatenate([[0], np.cumsum(differs)]) if len(points) else np.empty(0, np.intp)
    firsts = order[np.flatnonzero(np.concatenate([[True], differs]))] if len(points) else order
    rank = np.empty(len(firsts), dtype=np.intp)
    rank[np.argsort(firsts)] = np.arange(len(firsts))
    numbers = np.empty(len(points), dtype=np.intp)
    numbers[order] = rank[groups]
    return points[np.sort(firsts)], numbers[triangles]


def _known_suffix(path: str | os.PathLike[str], known: dict[str, Any]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in known:
        raise ValueError(
            f"the extension must be one of {', '.join(known)}, got {suffix or 'none'!r} "
            f"in {os.fspath(path)}"
        )
    return suffix


def _shape(mesh: TriangleMesh, placed: Placement, base: float | None, suffix: str) -> PlacedMesh:
    with np.errstate(over="ignore"):
        shape = place(mesh, placed, base)
    require_range(shape.vertices, suffix)
    return shape


def require_shape(mesh: TriangleMesh) -> None:
    """Raise TypeError or ValueError where a mesh has nothing that could be written."""
    if require_mesh(mesh).n_triangles == 0:
        raise ValueError("a mesh with triangles is wanted, got one without any")
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("vertices must be finite, got some that are not")


def require_range(points: NDArray[np.float64], suffix: str) -> None:
    """Raise a ValueError if the numbers of a format can't hold these."""
    bits, limit = (32, _LARGEST_32_BIT) if suffix in _IN_32_BITS else (64, np.finfo(float).max)
    largest = max(points.max(), -points.min())
    if largest > limit:
        raise ValueError(
            f"the {bits}-bit numbers of {suffix} are wanted up to {limit:.2g}, "
            f"but as scaled the mesh reaches {largest:.2g}"
        )
