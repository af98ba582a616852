"""Heights at the nodes of a lattice of any size, from memory, from a raster file, or from several.

Tiles and pyramids take their heights from these, window by window; see ``rtin.tiles``.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtin._crs import as_crs
from rtin._raster import padded
from rtin.grid import Grid
from rtin.io._geoid import GEOIDS, MissingGeoid, require_geoid, undulation, vertical
from rtin.io._mosaic import Mosaic, joined
from rtin.io._places import Nodes, Placement, smooth
from rtin.io._windows import RasterFile, fingerprint
from rtin.schemes import Scheme

if TYPE_CHECKING:
    import pyproj

__all__ = [
    "GridLattice",
    "MissingGeoid",
    "RasterLattice",
    "WebLattice",
    "fingerprint",
    "lacks_vertical_crs",
    "native_zoom",
]

Span = tuple[int, int]
Path = str | os.PathLike[str]
_MOST_NODES = 1 << 21  # worked on at a time
_LARGEST_ZOOM = 24
_GEOID_ERROR = 0.01  # metres
_NO_RISE = np.zeros((1, 1))


class GridLattice:
    """A ``HeightLattice`` of the samples of a grid in memory."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.rows: Span = (0, grid.shape[0])
        self.cols: Span = (0, grid.shape[1])
        self.period = None
        self.transform = grid.transform
        self.crs = grid.crs

    def read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights of a window; NaN where void or outside."""
        heights = self.grid.heights
        return padded(
            lambda rows, cols: heights[slice(*rows), slice(*cols)].copy(),
            (self.rows, self.cols),
            (rows, cols),
            heights.dtype,
        )


class RasterLattice:
    """A ``HeightLattice`` of a raster file's own samples, which is never read as a whole.

    Node (0, 0) is the centre of the file's first cell. Heights are those of ``read_grid``, and so
    are the errors, those of a damaged block with the window in which it lies. The file stays open
    in every thread that reads from it. Instances can be pickled, and used by several threads and
    processes.

    Parameters
    ----------
    path, band, encoding
        As in ``read_grid``. Colours whose encoding is not given are all read once, to recognise it.

    Raises
    ------
    OSError, TypeError, ValueError
        As ``read_grid``; infinite heights are found only when they are read.
    """

    def __init__(
        self,
        path: Path,
        *,
        band: int = 1,
        encoding: Literal["terrain-rgb", "terrarium", "none"] | None = None,
    ) -> None:
        self.file = RasterFile.of(path, band, encoding)
        self.rows: Span = (0, self.file.shape[0])
        self.cols: Span = (0, self.file.shape[1])
        self.period = None
        self.transform = self.file.transform

    @property
    def crs(self) -> pyproj.CRS | None:
        """The raster's CRS, None where it has none."""
        return self.file.crs

    def read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights of a window; NaN where void or outside.

        They are float32 where the file's type promises that it holds them (as scaled or coded
        heights, which are rounded to it, and integers of 16 bits), float64 otherwise.
        """
        file = self.file
        return padded(file.read, (self.rows, self.cols), (rows, cols), file.dtype)


def _common(one: Span, other: Span) -> Span:
    return max(one[0], other[0]), min(one[1], other[1])


class WebLattice:
    """A ``HeightLattice`` of the nodes of a tiling scheme at one zoom, over rasters in any CRS.

    Nodes are counted over the whole world, from the scheme's west and north; column c and
    c + ``period`` are one node. A node's height is bilinear between the four samples around it, in
    the raster's own grid, rounded to float32. Samples of weight zero do not count; where one of the
    others is void, so is the node. It depends on the node only, never on the window, to the last
    bit. Between a raster's outermost samples and the edges of their cells, half a cell further, the
    nearest samples' heights go on.

    Of several rasters the first one with a height at the node counts. Rasters that follow each
    other in the list and lie on one grid (same CRS, cells and alignment within a hundredth of a
    cell) are taken as one raster: heights are interpolated across their common edges, and a sample
    void in one may come from the next. A geographic raster, or such a mosaic, that goes round the
    world is interpolated across its ends. Where nodes lie on a raster is computed by PROJ in every
    16th node, and bilinear between those where that errs by less than a hundredth of a cell.

    Parameters
    ----------
    paths : sequence of path
        Rasters with a CRS; what ``read_grid`` reads.
    scheme, zoom, cells
        Which nodes: of that ``Scheme`` with so many cells along a tile.
    band, encoding
        As in ``read_grid``, for all rasters.
    geoid : {"egm2008", "egm96"}, optional
        The rasters' heights are above this geoid; the geoid's height is added, so that heights are
        above the WGS 84 ellipsoid, as web globes expect. A raster with a vertical CRS of its own is
        taken by that one. None: heights stay as they are.
    z_scale : float
        Multiplies the rasters' heights before that; 0.3048 for feet. A vertical CRS in feet is not
        converted by itself.

    Attributes
    ----------
    rows, cols : (int, int)
        Where heights may be, found without reading any. 0 <= cols[0] < period; cols[1] is beyond
        ``period`` where the rasters lie on both sides of the scheme's west edge.

    Raises
    ------
    OSError, TypeError, ValueError
        As ``RasterLattice``; and ValueError for a raster without CRS, or nowhere on Earth or in
        the scheme, and where PROJ lacks the geoid's grid: the message says which.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        scheme: Scheme,
        zoom: int,
        cells: int,
        *,
        band: int = 1,
        encoding: Literal["terrain-rgb", "terrarium", "none"] | None = None,
        geoid: Literal["egm2008", "egm96"] | None = None,
        z_scale: float = 1.0,
    ) -> None:
        if geoid not in (None, *GEOIDS):
            raise ValueError(f"geoid must be 'egm2008', 'egm96' or None, got {geoid!r}")
        self.nodes = Nodes(scheme, zoom, cells)
        self.period = self.nodes.shape[1]
        self.transform = scheme.transform(zoom, cells)
        self.z_scale = float(z_scale)
        mosaics = joined(_placed_files(paths, band, encoding))
        self._sources = [
            (mosaic, _surface(mosaic, geoid), _span(mosaic, self.nodes)) for mosaic in mosaics
        ]
        for _, surface, _ in self._sources:
            if surface is not None:
                require_geoid(surface)
        spans = [span for _, _, span in self._sources]
        self.rows: Span = min(rows[0] for rows, _ in spans), max(rows[1] for rows, _ in spans)
        self.cols: Span = _ring_of([cols for _, cols in spans], self.period)

    @property
    def crs(self) -> pyproj.CRS | None:
        """The scheme's CRS."""
        return as_crs(self.nodes.scheme.crs)

    def read(self, rows: Span, cols: Span) -> NDArray[np.float32]:
        """Return the heights of a window, float32; NaN where void or outside."""
        heights = np.full((rows[1] - rows[0], cols[1] - cols[0]), np.nan, np.float32)
        for mosaic, surface, span in self._sources:
            for part_rows, part_cols, lap in _parts(span, (rows, cols), self.period):
                top, left = part_rows[0] - rows[0], part_cols[0] - cols[0]
                bottom, right = part_rows[1] - rows[0], part_cols[1] - cols[0]
                view = heights[top:bottom, left:right]
                void = np.isnan(view)
                if void.any():
                    nodes = part_cols[0] - lap, part_cols[1] - lap
                    np.copyto(view, self._heights(mosaic, surface, part_rows, nodes), where=void)
        return heights

    def _heights(
        self, mosaic: Mosaic, surface: str | None, rows: Span, cols: Span
    ) -> NDArray[np.float32]:
        rises = _NO_RISE
        if surface is not None:
            rises = smooth(
                lambda *points: undulation(surface, *points), self.nodes, rows, cols, _GEOID_ERROR
            )[0]
        return mosaic.heights(self.nodes, rows, cols, self.z_scale, rises)


def native_zoom(paths: Sequence[Path], scheme: Scheme, cells: int) -> int:
    """Return the zoom whose nodes are as close as the finest raster's samples, or nearest to that.

    They are at most √2 times as far apart: a whole zoom more would make four times the tiles.

    Distances are those in the scheme's CRS halfway to a corner of each raster, along its rows or
    its columns, whichever are closer; the zoom is at most 24. Raises what ``WebLattice`` raises.
    """
    nodes = Nodes(scheme, 0, cells)
    files = _placed_files(paths, 1, "none")
    steps = []
    for file in files:
        mosaic = Mosaic((file,), ((0, 0),))
        _span(mosaic, nodes)  # raises where it lies nowhere
        steps.append(_sample_step(mosaic.placement, nodes))
    zoom = math.ceil(math.log2(1.0 / min(steps)) - 0.5)
    return min(max(zoom, 0), _LARGEST_ZOOM)


def lacks_vertical_crs(paths: Sequence[Path]) -> bool:
    """Return whether a raster's CRS does not say above what its heights are."""
    files = (RasterFile.of(path, 1, "none") for path in paths)
    return any(file.crs is None or len(file.crs.axis_info) < 3 for file in files)


def _placed_files(paths: Sequence[Path], band: int, encoding: str | None) -> list[RasterFile]:
    if isinstance(paths, str | os.PathLike) or not paths:
        raise ValueError(f"paths must be a list of at least one raster, got {paths!r}")
    files = [RasterFile.of(path, band, encoding) for path in paths]
    for file in files:
        if file.wkt is None:
            raise ValueError(
                f"{file.name} has no CRS; give it the one in which it lies on Earth, for "
                "example with gdal_edit.py -a_srs"
            )
    return files


def _surface(mosaic: Mosaic, geoid: str | None) -> str | None:
    """Return the vertical CRS whose height above the ellipsoid is added to a mosaic's heights."""
    crs = mosaic.files[0].crs
    if geoid is None or crs is None or (len(crs.axis_info) == 3 and not crs.is_compound):
        return None  # of three axes that are one, the third is the height above the ellipsoid
    own = vertical(crs)
    return GEOIDS[geoid] if own is None else own.to_wkt()


def _sample_step(placement: Placement, nodes: Nodes) -> float:
    """Return the distance of two samples halfway to a raster's corner, in spacings of the nodes.

    Where samples are not set by longitude, a degree of it counts for what it is beside one of
    latitude: around a pole all longitudes are near.
    """
    row, col = (n / 4.0 for n in placement.shape)
    lon, lat = placement.to_world(np.array([row, row, row + 1]), np.array([col, col + 1, col]))
    is_even = placement.is_separable or nodes.scheme.name == "mercator"
    share = 1.0 if is_even else math.cos(math.radians(lat[0]))
    x, y, half = nodes.cols_at(lon), nodes.rows_at(lat), nodes.shape[1] / 2
    return min(
        math.hypot(share * ((x[beside] - x[0] + half) % (2 * half) - half), y[beside] - y[0])
        for beside in (1, 2)
    )


def _span(mosaic: Mosaic, nodes: Nodes) -> tuple[Span, Span]:
    """Return the rows and columns of nodes between which all those in a mosaic's cells lie."""
    placement = mosaic.whole()
    lon, lat = placement.outline()
    if not (np.abs(lat) <= 90.0).any():
        crs, name = mosaic.files[0].crs, mosaic.files[0].name
        raise ValueError(
            f"{name} lies nowhere on Earth in its CRS, {crs and crs.name}; give it the one in "
            "which it does, for example with gdal_edit.py -a_srs"
        )
    rows, margin = nodes.rows_at(lat), 1e-6
    if rows.max() < 0.0 or rows.min() > nodes.shape[0] - 1:
        edge = nodes.latitudes(np.array([0]))[0]
        raise ValueError(
            f"{mosaic.files[0].name} lies beyond the scheme {nodes.scheme.name!r}, which ends at "
            f"{edge:.2f} degrees; leave it out, or take the scheme 'geographic'"
        )
    if not placement.is_separable:
        margin = 1.0 + 1e-3 * float(np.ptp(rows))
    first = max(0, math.ceil(rows.min() - margin))
    end = min(nodes.shape[0], math.floor(rows.max() + margin) + 1)
    for row, pole in ((0, 90.0), (nodes.shape[0] - 1, -90.0)):
        if placement.holds(0.0, pole):
            first, end = min(first, row), max(end, row + 1)
    return (first, end), _ring(placement, nodes, lon)


def _ring(placement: Placement, nodes: Nodes, lon: NDArray[np.float64]) -> Span:
    """Return the columns of nodes between which a raster lies."""
    period = nodes.shape[1]
    if placement.is_separable:
        first, end = placement.cols_of_edges(nodes)
        if end - first >= period - 1e-6:
            return 0, period
        return _on_ring(math.ceil(first - 1e-6), math.floor(end + 1e-6) + 1, period)
    if placement.holds(0.0, 90.0) or placement.holds(0.0, -90.0):
        return 0, period
    cols = np.unique(nodes.cols_at(lon) % period)
    gaps = np.diff(cols, append=cols[0] + period)
    widest = int(np.argmax(gaps))
    width = period - float(gaps[widest])
    if gaps[widest] < period / 64:
        return 0, period
    first, margin = float(cols[(widest + 1) % len(cols)]), 1.0 + 1e-3 * width
    return _on_ring(math.ceil(first - margin), math.floor(first + width + margin) + 1, period)


def _on_ring(first: int, end: int, period: int) -> Span:
    if end - first >= period:
        return 0, period
    return first % period, first % period + end - first


def _ring_of(spans: list[Span], period: int) -> Span:
    """Return the least span of a ring that holds all the others."""
    pieces = sorted(spans)
    gaps, reach = [], pieces[0][1]
    for first, end in pieces[1:]:
        gaps.append((first - reach, first))
        reach = max(reach, end)
    gaps.append((pieces[0][0] + period - reach, pieces[0][0]))
    size, first = max(gaps)
    if size <= 0:
        return 0, period
    return _on_ring(first, first + period - size, period)


def _parts(
    span: tuple[Span, Span], window: tuple[Span, Span], period: int
) -> Iterator[tuple[Span, Span, int]]:
    """Return the parts of a window in a source's span, each within a lap of the ring."""
    rows = _common(span[0], window[0])
    if rows[0] >= rows[1]:
        return
    first, end = window[1]
    for lap in range(first // period * period, end, period):
        for turn in (lap, lap - period):
            cols = _common(
                _common((lap, lap + period), window[1]), (span[1][0] + turn, span[1][1] + turn)
            )
            if cols[0] < cols[1]:
                step = max(1, _MOST_NODES // (cols[1] - cols[0]))
                for top in range(rows[0], rows[1], step):
                    yield (top, min(top + step, rows[1])), cols, lap
