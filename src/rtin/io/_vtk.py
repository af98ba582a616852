"""VTK's XML formats, through PyVista (an extra)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    data.field_data["rtin"] = np.frombuffer(placed.as_json().encode("ascii"), dtype=np.uint8)
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    if not writer.Write():
        raise OSError("VTK could not encode the mesh")
    text: str = writer.GetOutputString()
    return text.encode()


def read(path: Path) -> tuple[NDArray[np.float64], NDArray[np.integer[Any]], Any]:
    """Return vertices, triangles and the stored placement (or None) of a .vtp or .vtu file."""
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
    if isinstance(data, pyvista.PolyData):
        surface = data if data.is_all_triangles else data.triangulate()
        triangles = surface.faces.reshape(-1, 4)[:, 1:]
    else:
        surface = data.triangulate()
        triangles = surface.cells_dict.get(pyvista.CellType.TRIANGLE, np.empty((0, 3), int))
    placement = None if stored is None else json.loads(stored)
    return np.asarray(surface.points, dtype=np.float64), np.asarray(triangles), placement


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
