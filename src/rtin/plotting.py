"""Pictures of meshes, through matplotlib."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin import _tint
from rtin._atomic import require_place, write_bytes
from rtin._crs import metres_per_unit
from rtin._raster import widened
from rtin.criteria import vertical_error
from rtin.grid import Grid
from rtin.mesh import TriangleMesh, require_mesh

if TYPE_CHECKING:
    import pyproj
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

__all__ = ["plot", "require_picture_path", "save_picture", "show_at_its_place"]

_Floats = NDArray[np.float64]

# Above this many triangles each is smaller than a pixel or two, and filling them takes seconds.
_MOST_FILLED_TRIANGLES = 500_000
_MOST_PIXELS = 1500
_RASTERISED_FROM = 50_000


def plot(
    mesh: TriangleMesh,
    *,
    grid: Grid | None = None,
    ax: Axes | None = None,
    line_width: float | None = None,
) -> Axes:
    """Draw the triangles of ``mesh`` over shaded relief, seen from above.

    Parameters
    ----------
    mesh : TriangleMesh
    grid : Grid, optional
        Shade the heights of this grid, thinned out where it has more samples than the picture has
        pixels. Without it the triangles themselves are shaded, up to half a million of them.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure of pyplot's by default. Nothing is shown: call
        ``matplotlib.pyplot.show`` for that.
    line_width : float, optional
        Of the edges, in points. By default thinner the more triangles there are; 0 leaves them out.

    Returns
    -------
    matplotlib.axes.Axes
        A unit of y is as long as one of x on the ground (in degrees: 1 / cos(latitude) times as
        long on the page). The shading exaggerates flat terrain and tones down steep terrain, so
        brightness is no measure of slope.

    Raises
    ------
    ValueError
        If the mesh has no triangles.
    TypeError
        If ``mesh`` is not a TriangleMesh or ``grid`` not a Grid.
    """
    if grid is not None and not isinstance(grid, Grid):
        raise TypeError(f"a Grid is wanted for the relief, got {type(grid).__name__}")
    if require_mesh(mesh).n_triangles == 0:
        raise ValueError("a mesh with triangles is wanted, got one without any")
    if ax is None:
        from matplotlib import pyplot as plt

        _, ax = plt.subplots(layout="constrained")
    x_to_y = _aspect(mesh)
    if grid is not None:
        _draw_grid(ax, grid, x_to_y)
    elif mesh.n_triangles <= _MOST_FILLED_TRIANGLES:
        _fill_triangles(ax, mesh, x_to_y)
    _draw_edges(ax, mesh, line_width)
    _dress(ax, mesh, x_to_y)
    return ax


def save_picture(
    mesh: TriangleMesh,
    path: str | os.PathLike[str],
    *,
    grid: Grid | None = None,
    line_width: float | None = None,
    dots_per_inch: float = 150.0,
) -> None:
    """Write what ``plot`` draws to a picture; counts, and the error against ``grid``, above it.

    Parameters
    ----------
    mesh : TriangleMesh
    path : str or path-like
        The extension names the format: .png, .pdf, .svg or another that matplotlib writes. The
        file is written whole or not at all.
    grid, line_width
        As for ``plot``.
    dots_per_inch : float
        Of a picture 8 inches wide.

    Raises
    ------
    ValueError
        If matplotlib does not know the extension, the mesh has no triangles, or it covers no
        sample of ``grid``.
    OSError
        If the file cannot be written; what was there before is still there.

    Notes
    -----
    pyplot and its global state are not touched, so this works without a screen and in threads.
    """
    from matplotlib.figure import Figure

    suffix = _known_suffix(path)
    figure = Figure(figsize=_size(require_mesh(mesh)), layout="constrained")
    ax = plot(mesh, grid=grid, ax=figure.add_subplot(), line_width=line_width)
    title = f"{mesh.n_triangles:,} triangles, {mesh.n_vertices:,} vertices"
    if grid is not None:
        title += f"; largest vertical error {vertical_error(mesh, grid).max:.4g}"
    ax.set_title(title, fontsize=10)
    picture = io.BytesIO()
    figure.savefig(picture, format=suffix[1:], dpi=dots_per_inch)
    write_bytes(path, picture.getbuffer())


def require_picture_path(path: str | os.PathLike[str]) -> None:
    """Raise now what ``save_picture`` would raise because of ``path``, before the work is done.

    Raises
    ------
    ValueError
        If matplotlib does not know the extension.
    OSError
        If the folder does not exist or may not be written to, or ``path`` is a folder.
    """
    _known_suffix(path)
    require_place(path)


def _known_suffix(path: str | os.PathLike[str]) -> str:
    from matplotlib.backend_bases import FigureCanvasBase

    suffix = Path(path).suffix.lower()
    known = FigureCanvasBase.get_supported_filetypes()
    if suffix[1:] not in known:
        raise ValueError(
            f"the extension must be one of {', '.join(f'.{name}' for name in sorted(known))}, "
            f"got {suffix or 'none'!r} in {os.fspath(path)}"
        )
    return suffix


def _size(mesh: TriangleMesh) -> tuple[float, float]:
    """Return width and height in inches that leave little white around the map."""
    width, height, _ = np.ptp(mesh.bounds, axis=0)
    shape = height * _aspect(mesh) / width if width > 0.0 else 1.0
    return 8.0, float(np.clip(7.0 * shape + 1.0, 3.0, 16.0))


def _aspect(mesh: TriangleMesh) -> float:
    """Return how long a unit of y is in units of x, on the ground at the middle of the mesh."""
    if mesh.crs is None or not mesh.crs.is_geographic:
        return 1.0
    east, north = metres_per_unit(mesh.crs, float(mesh.bounds[:, 1].mean()))
    return north / east


def _draw_grid(ax: Axes, grid: Grid, x_to_y: float) -> None:
    step = -(-max(grid.shape) // _MOST_PIXELS)
    heights = grid.heights[::step, ::step].astype(np.float64)
    if min(heights.shape) < 2:
        return
    place = widened(grid.transform, step)
    slope_x, slope_y = _tint.slopes(heights, place)
    colours = _tint.relief(heights.ravel(), slope_x.ravel(), slope_y.ravel() / x_to_y)
    show_at_its_place(
        ax, colours.reshape(*heights.shape, 4), place,
        interpolation="bilinear" if step == 1 and heights.size < 250_000 else "auto",
    )  # fmt: skip


def show_at_its_place(ax: Axes, values: NDArray[Any], place: Affine, **options: Any) -> AxesImage:  # noqa: ANN401
    """Draw values, shape (rows, cols), as an image; ``place`` maps (col, row) to (x, y).

    The limits of the axes stay as they are. Options are those of ``imshow``.
    """
    from matplotlib.transforms import Affine2D

    to_world = Affine2D(np.array(place).reshape(3, 3))
    return ax.imshow(values, transform=to_world + ax.transData, zorder=0, **options)


def _fill_triangles(ax: Axes, mesh: TriangleMesh, x_to_y: float) -> None:
    from matplotlib.collections import PolyCollection

    corners = mesh.vertices[mesh.triangles]
    stretched = corners * [1.0, x_to_y, 1.0]
    normals = np.cross(stretched[:, 1] - stretched[:, 0], stretched[:, 2] - stretched[:, 0])
    up = np.where(normals[:, 2] == 0.0, 1.0, normals[:, 2])
    colours = _tint.relief(corners[:, :, 2].mean(axis=1), -normals[:, 0] / up, -normals[:, 1] / up)
    outlines: Any = corners[:, :, :2]  # an array does where the stubs want a sequence of them
    fill = PolyCollection(outlines, facecolors=colours, linewidths=0.0, antialiased=False, zorder=0)
    fill.set_rasterized(mesh.n_triangles > _RASTERISED_FROM)
    ax.add_collection(fill)


def _draw_edges(ax: Axes, mesh: TriangleMesh, line_width: float | None) -> None:
    """Draw every edge once, as one line with gaps: 20 times quicker than a LineCollection."""
    if line_width is None:
        line_width = float(np.clip(40.0 / np.sqrt(mesh.n_triangles), 0.08, 0.6))
    if line_width == 0.0:
        return
    edges = mesh.edges()
    points = np.full((len(edges), 3, 2), np.nan)
    points[:, :2] = mesh.vertices[edges, :2]
    ax.plot(
        *points.reshape(-1, 2).T,
        color="#1c2733",
        linewidth=line_width,
        rasterized=mesh.n_triangles > _RASTERISED_FROM,
        zorder=1,
    )


def _dress(ax: Axes, mesh: TriangleMesh, x_to_y: float) -> None:
    (west, south, _), (east, north, _) = mesh.bounds
    if east > west and north > south:
        ax.set_xlim(west, east)
        ax.set_ylim(south, north)
    ax.set_aspect(x_to_y)
    x_label, y_label = _labels(mesh.crs)
    ax.set_xlabel(x_label)
    ax.set_ylabel(y_label)
    ax.ticklabel_format(style="plain", useOffset=False)


def _labels(crs: pyproj.CRS | None) -> tuple[str, str]:
    if crs is None:
        return "x", "y"
    unit: Any = crs.axis_info[0].unit_name if crs.axis_info else ""
    if crs.is_geographic:
        return f"longitude ({unit})", f"latitude ({unit})"
    return f"x ({unit})", f"y ({unit})"
