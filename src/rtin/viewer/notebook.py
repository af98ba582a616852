"""Terrain in notebooks, and out of scripts: small pictures with figures, and pages to turn it in.

Nothing here needs a screen, a GPU or an extra: a notebook that shows a mesh again and again, of
whatever size, must neither wait nor end.
"""

from __future__ import annotations

import base64
import io
import os
import sys
import tempfile
import webbrowser
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine

from rtin import _tint
from rtin._options import as_count, as_exaggeration
from rtin._raster import widened
from rtin.coarsening import coarsen
from rtin.grid import Grid
from rtin.io.meshes import page_of, require_shape
from rtin.mesh import TriangleMesh
from rtin.viewer._from_above import heights_on, lattice_over, sampled

__all__ = ["as_html", "show"]

_Surface = Grid | TriangleMesh

_IN_A_CELL, _IN_A_PAGE = 50_000, 500_000  # triangles: 2.5 and 20 MB
_SAMPLES_EACH = 8  # of what is made simpler, for each triangle that is shown
_LONGEST, _SHOWN = 640, 420  # pixels of a small picture, and of a screen that it takes
_WITH_EDGES = 3000  # triangles: of more, edges are all there is to be seen
_INK = (25, 30, 45, 110)
_FRAME = '<iframe srcdoc="{page}" style="width:100%;height:480px;border:0"></iframe>'


def show(
    surface: Grid | TriangleMesh, *, exaggeration: float = 1.0, max_triangles: int | None = None
) -> None:
    """Show terrain in 3-D, to be turned with the mouse.

    In a Jupyter notebook (VS Code, Colab) the page stands below the cell, and is saved with the
    notebook. Anywhere else it is written to a temporary file and opened in the browser; ``show``
    doesn't wait, and the file stays. Either page holds all it needs and asks nobody for
    anything. ``rtin view`` shows rasters of any size: its level of detail follows the camera.

    Parameters
    ----------
    surface : Grid or TriangleMesh
        A mesh is shown as it is, a grid as the best mesh within ``max_triangles``.
    exaggeration : float
        What heights are multiplied by, from 1e-6 to 1e6.
    max_triangles : int, optional
        A mesh of more triangles is shown as the best mesh within that many of its own heights
        on a lattice, and the page says so. By default 50 000 in a notebook, which grows by 2.5 MB,
        and 500 000 elsewhere.

    Raises
    ------
    TypeError
        If ``surface`` is neither a grid nor a mesh.
    ValueError
        If a mesh has no triangle, or a number is out of range.
    OSError
        If the page can't be written, or there is no browser to open; the error says where it is.
    """
    if not isinstance(surface, Grid | TriangleMesh):
        raise TypeError(f"a Grid or a TriangleMesh is wanted, got {type(surface).__name__}")
    if isinstance(surface, TriangleMesh):
        require_shape(surface)
    exaggeration = as_exaggeration(exaggeration)
    is_cell = _is_in_notebook()
    if max_triangles is None:
        max_triangles = _IN_A_CELL if is_cell else _IN_A_PAGE
    if as_count("max_triangles", max_triangles) < 2:
        raise ValueError(f"max_triangles must be 2 or more, got {max_triangles}")
    mesh, note = _simple(surface, max_triangles)
    page = page_of(mesh, z_scale=exaggeration, note=note)
    if is_cell:
        _show_below_the_cell(page, repr(surface))
    else:
        _open(page)


def as_html(surface: Grid | TriangleMesh) -> str:
    """Return a small picture of terrain from above and what there is to say of it, as HTML.

    For notebooks, which call it unasked: quick for millions of triangles or samples, and what can't
    be drawn is left out rather than raised.
    """
    rows = "".join(
        f'<tr><td style="text-align:left">{name}</td>'
        f'<td style="text-align:left">{escape(text)}</td></tr>'
        for name, text in _facts(surface)
    )
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1em;align-items:center">'
        f"{_image_tag(surface)}<div><b>{type(surface).__name__}</b><table>{rows}</table></div></div>"
    )


# --- the small picture ----------------------------------------------------------------------------


def _facts(surface: _Surface) -> list[tuple[str, str]]:
    """Return names and texts of what there is to say."""
    if isinstance(surface, Grid):
        rows, cols = surface.shape
        counts = [("samples", f"{rows:,} × {cols:,}, {surface.heights.dtype}")]
        if surface.has_voids:
            counts.append(("voids", f"{rows * cols - surface.n_samples:,}"))
    else:
        names = ("triangles", surface.n_triangles), ("vertices", surface.n_vertices)
        counts = [(name, f"{number:,}") for name, number in names]
    crs = "none" if surface.crs is None else f"{surface.crs.name}"
    return [*counts, *_ranges(surface), ("CRS", crs)]


def _ranges(surface: _Surface) -> list[tuple[str, str]]:
    if isinstance(surface, TriangleMesh) and surface.n_vertices == 0:
        return []
    low, high = surface.bounds.tolist()
    return [
        (name, f"{least:.8g} to {largest:.8g}")
        for name, least, largest in zip("xyz", low, high, strict=True)
    ]


def _image_tag(surface: _Surface) -> str:
    try:
        with np.errstate(all="ignore"):  # or a cell would show what NumPy warns of, too
            data = _small_picture(surface)
    except Exception:  # whatever it is, a cell that shows a mesh must not fail over its picture
        return ""
    text = base64.b64encode(data).decode()
    style = f"max-width:{_SHOWN}px;max-height:{_SHOWN}px"
    return f'<img alt="from above" style="{style}" src="data:image/webp;base64,{text}">'


def _small_picture(surface: _Surface) -> bytes:
    """Return a WebP of a terrain from above, north up; transparent where there is none."""
    from PIL import Image

    transform, shape, in_metres = lattice_over(surface, _LONGEST**2)
    heights = heights_on(surface, transform, shape)
    slopes = (slope.ravel() for slope in _tint.slopes(heights, in_metres))
    colours = _tint.relief(heights.ravel(), *slopes).reshape(*shape, 4)
    image = Image.fromarray(np.rint(255.0 * colours).astype(np.uint8), "RGBA")
    if isinstance(surface, TriangleMesh) and surface.n_triangles <= _WITH_EDGES:
        image = Image.alpha_composite(image, _net(surface, transform, shape))
    file = io.BytesIO()
    image.save(file, "WEBP", quality=85)
    return file.getvalue()


def _net(mesh: TriangleMesh, transform: Affine, shape: tuple[int, int]) -> Any:  # noqa: ANN401
    """Return a transparent picture of a mesh's edges."""
    from PIL import Image, ImageDraw

    image = Image.new("RGBA", shape[::-1], (0, 0, 0, 0))
    pen = ImageDraw.Draw(image)
    a, _, x, _, e, y = tuple(transform)[:6]
    places = (mesh.vertices[:, :2] - (x, y)) / (a, e)
    for line in places[mesh.edges()]:
        pen.line([tuple(point) for point in line.tolist()], fill=_INK)
    return image


# --- the page -------------------------------------------------------------------------------------


def _simple(surface: _Surface, limit: int) -> tuple[TriangleMesh, str]:
    """Return a mesh of that many triangles at most, and what there is to say of it."""
    if isinstance(surface, TriangleMesh):
        if surface.n_triangles <= limit:
            return surface, ""
        mesh = _coarsened(sampled(surface, _SAMPLES_EACH * limit), limit)
        return mesh, f", of {surface.n_triangles:,} triangles"
    mesh = _coarsened(_thinned(surface, limit), limit)
    return mesh, f", of {surface.n_samples:,} samples"


def _coarsened(grid: Grid, limit: int) -> TriangleMesh:
    """Return the best mesh within a budget; of every other sample where voids leave none."""
    while True:
        try:
            return coarsen(grid, max_triangles=limit)
        except ValueError:
            if min(grid.shape) < 4:
                raise
            grid = Grid(grid.heights[::2, ::2], widened(grid.transform, 2), grid.crs)


def _thinned(grid: Grid, limit: int) -> Grid:
    step = int(np.ceil(np.sqrt(grid.heights.size / (_SAMPLES_EACH * limit))))
    if step <= 1 or min(grid.shape) <= step:
        return grid
    return Grid(grid.heights[::step, ::step], widened(grid.transform, step), grid.crs)


def _is_in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this; nothing is imported to find out."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


def _show_below_the_cell(page: bytes, text: str) -> None:
    from IPython.display import display

    frame = _FRAME.format(page=escape(page.decode()))
    display({"text/html": frame, "text/plain": text}, raw=True)  # type: ignore[no-untyped-call]


def _open(page: bytes) -> None:
    number, name = tempfile.mkstemp(prefix="rtin-", suffix=".html")
    with os.fdopen(number, "wb") as file:
        file.write(page)
    if not webbrowser.open(Path(name).as_uri()):
        raise OSError(f"there is no browser to show the terrain in; the page is {name}")
