"""What a notebook shows of meshes and rasters, and the page that ``mesh.show()`` opens."""

from __future__ import annotations

import base64
import html
import io
import sys
import tempfile
import webbrowser
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine

from rtin import _tint
from rtin._crs import metres_per_unit
from rtin.criteria import vertical_error
from rtin.grid import Grid
from rtin.io import write_mesh
from rtin.mesh import TriangleMesh, require_mesh

__all__ = ["as_html", "show"]

_LONGEST = 480  # pixels of a picture beside a cell
_MOST_TRIANGLES = 500_000  # of a page: 15 MB
_FRAME = '<iframe srcdoc="{page}" width="100%" height="{height}" style="border:0"></iframe>'
_CARD = (
    '<div><img src="data:image/png;base64,{picture}" style="max-width:100%" alt="shaded relief">'
    '<div style="font:12px sans-serif;opacity:.8">{caption}</div></div>'
)


def show(mesh: TriangleMesh, *, height: int = 480) -> Any:  # noqa: ANN401  (IPython's)
    """Show a mesh to turn and zoom: below the cell of a notebook, or in the browser.

    The page holds all it needs, so it works without a network; up to half a million triangles.
    ``rtin view`` is for larger ones, and for rasters.

    Parameters
    ----------
    mesh : TriangleMesh
    height : int
        Of the frame in a notebook, in pixels.

    Returns
    -------
    IPython.display.HTML or pathlib.Path
        In a notebook what it displays; else the temporary file that the browser was given.

    Raises
    ------
    TypeError
        If ``mesh`` is no TriangleMesh.
    ValueError
        If the mesh has no triangle, or more than half a million.
    """
    n = require_mesh(mesh).n_triangles
    if not 0 < n <= _MOST_TRIANGLES:
        raise ValueError(
            f"a page shows 1 to {_MOST_TRIANGLES:,} triangles, got {n:,}; "
            "write it to a file and run `rtin view` on that"
        )
    with tempfile.NamedTemporaryFile(prefix="rtin-", suffix=".html", delete=False) as file:
        path = Path(file.name)
    write_mesh(mesh, path)
    if not _in_notebook():
        webbrowser.open(path.as_uri())
        return path
    display: Any = import_module("IPython.display")
    page = html.escape(path.read_text(encoding="utf-8"), quote=True)
    path.unlink()
    return display.HTML(_FRAME.format(page=page, height=int(height)))


def as_html(surface: Grid | TriangleMesh) -> str:
    """Return a small picture of a mesh or raster with its counts, as a notebook shows it."""
    caption = html.escape(repr(surface)[1:-1])
    try:
        picture = _picture(surface)
    except (ValueError, MemoryError):  # of a mesh that has no surface to be seen from above
        return f"<div>{caption}</div>"
    return _CARD.format(picture=base64.b64encode(picture).decode("ascii"), caption=caption)


def _in_notebook() -> bool:
    """Return whether a front end that displays HTML asks."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")


def _picture(surface: Grid | TriangleMesh) -> bytes:
    """Return relief, lit from the north-west, as a PNG; transparent where there is no surface."""
    from PIL import Image

    seen = _thinned(surface) if isinstance(surface, Grid) else _from_above(surface)
    heights = seen.heights.astype(np.float64)
    slope_x, slope_y = (slope.ravel() for slope in _tint.slopes(heights, seen.transform))
    colours = _tint.relief(heights.ravel(), slope_x, slope_y)
    image = np.rint(255.0 * colours).astype(np.uint8).reshape(*seen.shape, 4)
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


def _thinned(grid: Grid) -> Grid:
    """Return every so many-th row and column of a grid."""
    step = -(-max(grid.shape) // _LONGEST)
    a, b, x0, d, e, y0 = tuple(grid.transform)[:6]
    heights = grid.heights[::step, ::step]
    if min(heights.shape) < 2:
        raise ValueError("too narrow for a picture")
    return Grid(heights, Affine(a * step, b * step, x0, d * step, e * step, y0))


def _from_above(mesh: TriangleMesh) -> Grid:
    """Return the heights of a mesh on a lattice over its bounds; NaN where it has none."""
    (x, y, _), (right, top, _) = mesh.bounds.tolist()
    width, height = right - x, top - y
    if not (width > 0.0 and height > 0.0):
        raise ValueError("no surface from above")
    stretch = 1.0
    if mesh.crs is not None and mesh.crs.is_geographic:
        east, north = metres_per_unit(mesh.crs, (y + top) / 2.0)
        stretch = north / east
    pixel = max(width, height * stretch) / (_LONGEST - 1)
    shape = (max(2, int(height * stretch / pixel) + 1), max(2, int(width / pixel) + 1))
    steps = (width / (shape[1] - 1), -height / (shape[0] - 1))
    lattice = Grid(np.zeros(shape, np.float32), (steps[0], 0.0, x, 0.0, steps[1], top))
    return Grid(vertical_error(mesh, lattice).field, lattice.transform)

