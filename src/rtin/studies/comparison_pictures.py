"""The pictures of ``rtin compare``: where surfaces differ, error against vertices, the meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._raster import moved, widened
from rtin._surfaces import bounds_of, local_system
from rtin.criteria import VerticalError, vertical_error
from rtin.distance import compare
from rtin.grid import Grid
from rtin.mesh import TriangleMesh
from rtin.plotting import show_at_its_place
from rtin.studies._drawing import draw_mesh, picture, write_picture
from rtin.studies.comparison import OURS, Comparison, Pair, Row, label_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

__all__ = ["Picture", "of_comparison", "of_pair", "write_maps", "write_pair"]

_Floats = NDArray[np.float64]

_PANEL = 3.0  # inches wide
_MOST_COLUMNS = 3
_MOST_PIXELS = 600  # a side of a map
_PIXELS_OF_SAMPLES = 300
_SAMPLES_PER_PIXEL = 8
_DRAWN_TRIANGLES = 1200  # of our mesh: more would be black
_SHADES = 20  # few, so that values can be read off, and noise compresses
_BESIDE = "#e4e4e4"  # where there is no sample or no surface
_RING = "#00b050"
_BEYOND = {"under": "#00f0ff", "over": "#ffd500"}  # blue and red get no darker
_COLOURS = (
    "#2f6f9f", "#b5532a", "#6b7f2a", "#7a4f9a", "#c08a1e", "#2a8a7f", "#a83a66",
    "#5a5f66", "#8c6d46", "#3d55b0", "#d0679d", "#4f9a4f", "#b03a3a",
)  # fmt: skip
_MARKERS = "osD^vP*Xp<>hd"


class Picture(NamedTuple):
    """A picture in PNG, and what it shows."""

    caption: str
    png: bytes


class _Figure(NamedTuple):
    """A figure still to be drawn: its size in inches, and what draws it."""

    size: tuple[float, float]
    draw: Callable[[Any], None]

    def drawn(self, caption: str) -> Picture:
        return Picture(caption, bytes(picture(self.size, self.draw)))


def of_pair(pair: Pair) -> list[Picture]:
    """Return the picture of two surfaces."""
    return [_of_pair(pair).drawn(_caption_of_pair(pair))]


def write_pair(pair: Pair, path: Path) -> None:
    """Write the picture of two surfaces; the extension names the format."""
    write_picture(path, *_of_pair(pair))


def of_comparison(comparison: Comparison) -> list[Picture]:
    """Return the pictures of a comparison: errors against vertices, then maps and meshes."""
    pictures = [_curves(comparison).drawn("Error against vertices.")]
    for max_error in comparison.tolerances():
        rows = comparison.rows_at(max_error)
        limit = _limit_at(max_error)
        maps = (
            f"Surface minus raster for {max_error:g}: blue lies below it and red above, on one "
            f"scale up to {limit:g}; cyan and yellow are beyond that, grey is not covered."
        )
        pictures.append(_maps(comparison, [max_error]).drawn(maps))
        share = _drawn_share(rows)
        part = "The meshes" if share == 1.0 else f"The middle {100 * share:.2g} % of the sides"
        pictures.append(_meshes(comparison.grid, rows, share).drawn(f"{part} for {max_error:g}."))
    return pictures


def write_maps(comparison: Comparison, path: Path) -> None:
    """Write all maps of errors, a row for each tolerance; the extension names the format."""
    write_picture(path, *_maps(comparison, comparison.tolerances()))


# --- two surfaces -------------------------------------------------------------------------------


def _of_pair(pair: Pair) -> _Figure:
    height = _height(pair.a, pair.b)
    if pair.vertical is not None:
        width = 6.5
        return _Figure((width, width * height + 0.4), partial(_draw_vertical, pair=pair))
    return _Figure((9.0, 4.1 * height + 0.6), partial(_draw_distances, pair=pair))


def _caption_of_pair(pair: Pair) -> str:
    if pair.vertical is not None:
        return "Mesh minus raster, upright: blue lies below the raster, red above it."
    return "The largest distance at each place, from each surface to the other."


def _draw_vertical(figure: Figure, pair: Pair) -> None:
    error, grid = pair.vertical, pair.a if isinstance(pair.a, Grid) else pair.b
    assert error is not None
    assert isinstance(grid, Grid)
    ax = figure.add_subplot()
    image = _draw_error(ax, error, grid, error.max)
    place = moved(grid.transform, *error.sample)
    _mark(ax, place.c, place.f, error.max)
    ax.set_title(f"mesh minus raster: rms {error.rms:.4g}, mean {error.mean:.4g}")
    figure.colorbar(image, ax=ax, shrink=0.8)


def _draw_distances(figure: Figure, pair: Pair) -> None:
    axes = figure.subplots(1, 2)
    ways = pair.distance.forward, pair.distance.backward
    largest = max(way.max for way in ways) or 1.0
    fields = _largest_by_place(pair.a, pair.b), _largest_by_place(pair.b, pair.a)
    for ax, way, field, name in zip(axes, ways, fields, ("A to B", "B to A"), strict=True):
        image = show_at_its_place(ax, *field, cmap=_map_from("magma_r"), vmin=0.0, vmax=largest,
                                  interpolation="nearest")  # fmt: skip
        _frame(ax, pair.a, pair.b)
        _mark(ax, *way.place[:2], way.max)
        ax.set_title(f"{name}: rms {way.rms:.4g}, mean {way.mean:.4g}")
    figure.colorbar(image, ax=axes, shrink=0.8)


def _mark(ax: Axes, x: float, y: float, largest: float) -> None:
    ax.plot(x, y, "o", mfc="none", mec=_RING, mew=1.8, ms=10.0, ls="", clip_on=False,
            label=f"largest: {largest:.4g}")  # fmt: skip
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, 0.0))


def _largest_by_place(
    source: TriangleMesh | Grid, target: TriangleMesh | Grid
) -> tuple[_Floats, Affine]:
    """Return the largest distance in each pixel seen from above, and where the pixels are."""
    low, high = bounds_of(source)
    size = np.where(high > low, high - low, 1.0)
    shape = np.maximum(1, np.ceil(_PIXELS_OF_SAMPLES * size / size.max())).astype(int)
    cell = size / shape
    samples = _SAMPLES_PER_PIXEL * int(shape.prod())
    field = compare(source, target, "similar", samples=samples).forward.field
    col, row = np.clip((field.points[:, :2] - low) / cell, 0, shape - 1).astype(int).T
    largest = np.full(shape[::-1], -1.0)
    np.maximum.at(largest, (row, col), field.distances)
    largest[largest < 0.0] = np.nan
    (width, height), (x, y) = cell.tolist(), (low + 0.5 * cell).tolist()
    place = Affine(width, 0.0, x, 0.0, height, y)
    return largest, place


# --- maps of signed errors ----------------------------------------------------------------------


def _maps(comparison: Comparison, tolerances: Sequence[float]) -> _Figure:
    """Return maps side by side: few enough fit in a row for each tolerance, else they go on."""
    rows = [row for max_error in tolerances for row in comparison.rows_at(max_error)]
    widest = max(len(comparison.rows_at(max_error)) for max_error in tolerances)
    n_cols = min(_MOST_COLUMNS, widest) if len(tolerances) == 1 else widest
    draw = partial(_draw_maps, comparison=comparison, tolerances=tolerances, n_cols=n_cols)
    n_lines = -(-len(rows) // n_cols) if len(tolerances) == 1 else len(tolerances)
    panel = _PANEL * _height(comparison.grid) + 0.6
    return _Figure((_PANEL * n_cols + 0.8, panel * n_lines), draw)


def _draw_maps(
    figure: Figure, comparison: Comparison, tolerances: Sequence[float], n_cols: int
) -> None:
    parts: Any = figure.subfigures(len(tolerances), 1, squeeze=False)
    for part, max_error in zip(parts[:, 0], tolerances, strict=True):
        rows = comparison.rows_at(max_error)
        axes = part.subplots(-(-len(rows) // n_cols), n_cols, squeeze=False)
        for ax in axes.ravel()[len(rows) :]:
            ax.set_axis_off()
        for ax, row in zip(axes.ravel(), rows, strict=False):
            error = vertical_error(row.mesh, comparison.grid)
            image = _draw_error(ax, error, comparison.grid, _limit_at(max_error))
            ax.set_title(_title(row, f"max {error.max:.4g}, rms {error.rms:.4g}"))
        part.colorbar(image, ax=axes, shrink=0.8, aspect=30, extend="both")


def _title(row: Row, figures: str) -> str:
    return f"{label_of(row.name)}, {row.figures.n_vertices:,} vertices\n{figures}"


def _limit_at(max_error: float) -> float:
    """Return what the colours go up to: the tolerance, so that those beyond it stand out."""
    return max_error or 1.0


def _draw_error(ax: Axes, error: VerticalError, grid: Grid, limit: float) -> AxesImage:
    step = -(-max(grid.shape) // _MOST_PIXELS)
    middle = (step - 1) / 2
    place = widened(moved(grid.transform, middle, middle), step)
    limit = limit or 1.0
    image = show_at_its_place(
        ax, _largest_of_blocks(error.field, step), place, cmap=_map_from("RdBu_r"),
        vmin=-limit, vmax=limit, interpolation="nearest",
    )  # fmt: skip
    _frame(ax, grid)
    return image


def _largest_of_blocks(values: _Floats, step: int) -> _Floats:
    """Return of each step × step values the one farthest from zero; NaN where all are."""
    rows, cols = (-(-n // step) for n in values.shape)
    missing = [(0, n * step - had) for n, had in zip((rows, cols), values.shape, strict=True)]
    blocks = np.pad(values, missing, constant_values=np.nan).reshape(rows, step, cols, step)
    flat = blocks.swapaxes(1, 2).reshape(rows, cols, step * step)
    sizes = np.where(np.isnan(flat), -1.0, np.abs(flat))
    return np.take_along_axis(flat, sizes.argmax(axis=2)[..., np.newaxis], axis=2)[..., 0]


def _map_from(name: str) -> Any:  # noqa: ANN401
    from matplotlib import colormaps

    return colormaps[name].resampled(_SHADES).with_extremes(bad=_BESIDE, **_BEYOND)


def _frame(ax: Axes, *surfaces: TriangleMesh | Grid) -> None:
    """Set the limits to the surfaces, with equal lengths on the ground, and no axes."""
    low, high = _outline(*surfaces)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
    ax.set_aspect(_stretch(*surfaces))


def _outline(*surfaces: TriangleMesh | Grid) -> tuple[_Floats, _Floats]:
    bounds = np.array([bounds_of(surface) for surface in surfaces])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    thin = high <= low
    return low - thin, high + thin


def _stretch(*surfaces: TriangleMesh | Grid) -> float:
    east, north = local_system(*surfaces).scale.tolist()
    return float(north / east)


def _height(*surfaces: TriangleMesh | Grid) -> float:
    """Return how high a map is in parts of its width, within what a page can show."""
    low, high = _outline(*surfaces)
    width, height = (high - low).tolist()
    return float(np.clip(height * _stretch(*surfaces) / width, 0.3, 3.0))


# --- error against vertices ---------------------------------------------------------------------


def _curves(comparison: Comparison) -> _Figure:
    return _Figure((9.0, 3.8), partial(_draw_curves, comparison=comparison))


def _draw_curves(figure: Figure, comparison: Comparison) -> None:
    axes = figure.subplots(1, 2)
    for ax, key in zip(axes, ("max", "rms"), strict=True):
        for number, name in enumerate(comparison.names()):
            rows = [row for row in comparison.rows if row.name == name]
            errors = np.array([getattr(row.figures, key) for row in rows])
            vertices = np.array([row.figures.n_vertices for row in rows])
            drawn = errors > 0.0  # an exact mesh has no place on such an axis
            ax.plot(
                vertices[drawn], errors[drawn], "-" + _MARKERS[number % len(_MARKERS)],
                ms=4.0, lw=2.0 if name == OURS else 1.1, label=label_of(name),
                color=_COLOURS[number % len(_COLOURS)],
            )  # fmt: skip
        ax.set(xlabel="vertices", title=f"vertical error, {key}")
        if any(getattr(row.figures, key) > 0.0 for row in comparison.rows):
            ax.set(xscale="log", yscale="log")
            _number_plainly(ax)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper")


def _number_plainly(ax: Axes) -> None:
    """Number log axes 1, 2, 5, 10, … in full, where they span too little for powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
        axis.set_minor_locator(NullLocator())


# --- meshes -------------------------------------------------------------------------------------


def _meshes(grid: Grid, rows: Sequence[Row], share: float) -> _Figure:
    n_cols = min(_MOST_COLUMNS, len(rows))
    size = (_PANEL * n_cols, (_PANEL * _height(grid) + 0.4) * -(-len(rows) // n_cols))
    return _Figure(size, partial(_draw_meshes, grid=grid, rows=rows, share=share, n_cols=n_cols))


def _drawn_share(rows: Sequence[Row]) -> float:
    """Return what part of the sides is drawn, so that triangles can be told apart."""
    n_triangles = rows[0].mesh.n_triangles
    return 1.0 if n_triangles <= 2 * _DRAWN_TRIANGLES else (_DRAWN_TRIANGLES / n_triangles) ** 0.5


def _draw_meshes(
    figure: Figure, grid: Grid, rows: Sequence[Row], share: float, n_cols: int
) -> None:
    low, high = _outline(grid)
    middle, half = (low + high) / 2.0, share * (high - low) / 2.0
    axes = figure.subplots(-(-len(rows) // n_cols), n_cols, squeeze=False)
    for ax in axes.ravel()[len(rows) :]:
        ax.set_axis_off()
    for ax, row in zip(axes.ravel(), rows, strict=False):
        draw_mesh(ax, _part_of(row.mesh, middle - half, middle + half), line_width=0.3)
        ax.set_xlim(*(middle[0] + [-half[0], half[0]]))
        ax.set_ylim(*(middle[1] + [-half[1], half[1]]))
        ax.set_aspect(_stretch(grid))
        ax.set_title(_title(row, f"{row.figures.n_triangles:,} triangles"))


def _part_of(mesh: TriangleMesh, low: _Floats, high: _Floats) -> TriangleMesh:
    """Return the triangles whose bounds reach into a rectangle."""
    corners = mesh.vertices[mesh.triangles, :2]
    reaches = (corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)
    return TriangleMesh(mesh.vertices, mesh.triangles[reaches.all(axis=1)], mesh.crs)
