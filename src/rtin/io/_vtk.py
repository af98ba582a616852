"""VTK's XML formats, through PyVista (an extra)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rtin.io._cells import FileMesh, find_tags
from rtin.io._numbers import require_plausible
from rtin.io._placement import PlacedMesh

__all__ = ["read", "require_pyvista", "vtp", "vtu"]

_COUNT = re.compile(rb"""NumberOf\w+\s*=\s*["']\s*(\d+)""")


def vtp(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as VTK PolyData (.vtp)."""
    pyvista = require_pyvista()
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    data = pyvista.PolyData.from_regular_faces(placed.vertices, placed.triangles)
    return _encoded(vtkXMLPolyDataWriter(), data, placed)


def vtu(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as a VTK unstructured grid (.vtu)."""
    pyvista = require_pyvista()
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    cells = {pyvista.CellType.TRIANGLE: placed.triangles}
    data = pyvista.UnstructuredGrid(cells, placed.vertices)
    return _encoded(vtkXMLUnstructuredGridWriter(), data, placed)


def _encoded(writer: Any, data: Any, placed: PlacedMesh) -> bytes:  # noqa: ANN401
    """Return the file as bytes: VTK's own writing to disk aborts the process on a full disk.

    The placement is an array of ASCII codes: meshio reads no file that has an array of strings.
    """
    data.point_data["elevation"] = placed.vertices[:, 2]  # what ParaView colours by
    if placed.tags is not None:
        data.cell_data["tag"] = placed.tags
    data.field_data["rtin"] = np.frombuffer(placed.as_json().encode("ascii"), dtype=np.uint8)
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    if not writer.Write():
        raise OSError("VTK could not encode the mesh")
    text: str = writer.GetOutputString()
    return text.encode()


def read(path: Path) -> FileMesh:
    """Return what is in a .vtp or .vtu file."""
    pyvista = require_pyvista()
    # VTK ends the process where a damaged number asks for more memory than there is.
    content = path.read_bytes()
    for announced in _COUNT.findall(content):
        require_plausible(int(announced[:20]), len(content))
    with _silence():
        data = pyvista.read(path)
    if data.n_points == 0:
        raise ValueError("VTK finds no points in it")
    stored = bytes(data.field_data["rtin"]) if "rtin" in data.field_data else None
    # PolyData with lines loses track of its cell data in VTK's filter for it.
    grid = data.cast_to_unstructured_grid() if isinstance(data, pyvista.PolyData) else data
    _require_flat_cells(grid)
    surface = grid.triangulate()
    triangles = surface.cells_dict.get(pyvista.CellType.TRIANGLE, np.empty((0, 3), int))
    cells = np.flatnonzero(surface.celltypes == pyvista.CellType.TRIANGLE)
    tags = find_tags(surface.cell_data)
    return FileMesh(
        np.asarray(surface.points, dtype=np.float64),
        np.asarray(triangles),
        None if stored is None else json.loads(stored),
        None if tags is None else tags[cells],
    )


def _require_flat_cells(data: Any) -> None:  # noqa: ANN401
    """Raise ValueError where an unstructured grid has cells with a volume, such as tetrahedra."""
    for first in np.unique(data.celltypes, return_index=True)[1].tolist():
        cell = data.GetCell(first)
        if cell.GetCellDimension() > 2:
            kind = cell.GetClassName().removeprefix("vtk")
            raise ValueError(f"triangles and quads are wanted, got cells of kind {kind}")


@contextmanager
def _silence() -> Iterator[None]:
    """Keep VTK from printing a page about a broken file; the caller says it in one line."""
    from vtkmodules.vtkCommonCore import vtkObject

    display = vtkObject.GetGlobalWarningDisplay()
    vtkObject.GlobalWarningDisplayOff()
    try:
        yield
    finally:
        vtkObject.SetGlobalWarningDisplay(display)


def require_pyvista() -> Any:  # noqa: ANN401
    """Return the module, or raise an ImportError that says how to install it."""
    try:
        import pyvista
    except ModuleNotFoundError:
        raise ImportError(
            'VTK\'s formats need PyVista, which is not installed; pip install "rtin[vtk]"'
        ) from None
    return pyvista
