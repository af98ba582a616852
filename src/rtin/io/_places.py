"""Where the nodes of a tiling scheme lie on a raster, the same whatever window is asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtin._crs import as_crs
from rtin.schemes import EQUATORIAL_RADIUS, Scheme

if TYPE_CHECKING:
    import pyproj

__all__ = ["Nodes", "Placement", "horizontal", "smooth"]

STEP = 16  # nodes from one control node to the next
_SNAP = 1e-6  # of a cell, as in Grid
_LARGEST_ERROR = 0.01  # of a cell
_SAFETY = 2.0

Span = tuple[int, int]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Nodes:
    """The nodes of a scheme at a zoom, counted over the world from its north-west corner."""

    scheme: Scheme
    zoom: int
    cells: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, the last one at the southern edge, and columns, which close to a ring."""
        rows, cols = self.scheme.tile_shape(self.zoom)
        return rows * self.cells + 1, cols * self.cells

    @property
    def spacing(self) -> float:
        """Between two nodes, in units of the scheme's CRS."""
        return self.scheme.spacing(self.zoom, self.cells)

    def longitudes(self, cols: NDArray[np.int64]) -> Floats:
        """Degrees, by a formula of the column alone."""
        x = self.scheme.west + cols.astype(np.float64) * self.spacing
        return x if self.scheme.crs == "EPSG:4326" else x * (180.0 / (math.pi * EQUATORIAL_RADIUS))

    def latitudes(self, rows: NDArray[np.int64]) -> Floats:
        """Degrees, by a formula of the row alone."""
        y = self.scheme.north - rows.astype(np.float64) * self.spacing
        if self.scheme.crs == "EPSG:4326":
            return y
        return np.array(
            [math.degrees(math.atan(math.sinh(value / EQUATORIAL_RADIUS))) for value in y]
        )

    def cols_at(self, longitudes: Floats) -> Floats:
        """The inverse of ``longitudes``, with fractions."""
        degrees = self.scheme.spacing(self.zoom, self.cells) * 360.0 / self.scheme.width
        return (np.asarray(longitudes) + 180.0) / degrees

    def rows_at(self, latitudes: Floats) -> Floats:
        """The inverse of ``latitudes``, with fractions."""
        y = np.asarray(latitudes, np.float64)
        if self.scheme.crs != "EPSG:4326":
            y = _mercator_y(np.clip(y, -89.9, 89.9))
        return (self.scheme.north - y) / self.spacing


def _mercator_y(latitudes: Floats) -> Floats:
    return np.array(
        [EQUATORIAL_RADIUS * math.asinh(math.tan(math.radians(value))) for value in latitudes]
    )


def horizontal(crs: pyproj.CRS) -> pyproj.CRS:
    """Return the part of a CRS that says where, not how high."""
    if crs.is_compound:
        return horizontal(crs.sub_crs_list[0])
    return crs.to_2d() if len(crs.axis_info) == 3 else crs


@lru_cache(maxsize=64)
def _kind(wkt: str) -> str:
    """Return "degrees" or "mercator" where x and y are formulas of WGS 84's longitude, latitude."""
    crs = as_crs(wkt)
    assert crs is not None
    for kind, code in (("degrees", 4326), ("mercator", 3857)):
        if crs.equals(as_crs(code), ignore_axis_order=True):
            return kind
    return "other"


@lru_cache(maxsize=64)
def _transformer(wkt: str) -> Any:  # noqa: ANN401
    import pyproj

    try:
        return pyproj.Transformer.from_crs("EPSG:4326", wkt, always_xy=True)
    except pyproj.exceptions.ProjError as error:
        reason = " ".join(str(error).split())
        name = wkt.split('"')[1]
        raise ValueError(
            f"a CRS on Earth is wanted, got {name!r}: no way from EPSG:4326: {reason}"
        ) from None


@dataclass(frozen=True)
class Placement:
    """Where longitude and latitude lie on a raster, in rows and columns of samples.

    Attributes
    ----------
    wkt : str
        The raster's horizontal CRS.
    place : six floats
        Maps (col, row) of a sample to (x, y).
    shape : (int, int)
        Rows and columns of samples.
    """

    wkt: str
    place: tuple[float, ...]
    shape: tuple[int, int]

    @cached_property
    def kind(self) -> str:
        """How x and y follow from longitude and latitude: "degrees", "mercator" or "other"."""
        return _kind(self.wkt)

    @cached_property
    def is_separable(self) -> bool:
        """Whether the column follows from the longitude alone, and the row from the latitude."""
        _, b, _, d, _, _ = self.place
        return self.kind != "other" and b == 0.0 and d == 0.0

    @cached_property
    def world(self) -> float:
        """The way round the world in units of x, 0 where x does not come back."""
        crs = as_crs(self.wkt)
        assert crs is not None
        if self.kind == "mercator":
            return 2.0 * math.pi * EQUATORIAL_RADIUS
        if crs.is_geographic:
            return 2.0 * math.pi / crs.axis_info[0].unit_conversion_factor
        return 0.0

    @cached_property
    def period(self) -> int:
        """Columns of samples round the world, 0 where they are not a whole number."""
        a, b, _, d, _, _ = self.place
        if not self.world or b or d:
            return 0
        cols = self.world / abs(a)
        return round(cols) if abs(cols - round(cols)) < _LARGEST_ERROR else 0

    def at(self, longitudes: Floats, latitudes: Floats) -> tuple[Floats, Floats]:
        """Return rows and columns of points, by PROJ; NaN where it finds none."""
        x, y = _transformer(self.wkt).transform(longitudes, latitudes)
        return self._on_raster(np.asarray(x), np.asarray(y))

    def axes(self, longitudes: Floats, latitudes: Floats) -> tuple[Floats, Floats]:
        """Return rows (n, 1) and columns (1, m) where the raster is separable."""
        if self.kind == "degrees":
            x, y = longitudes, latitudes
        else:
            x, y = (
                np.radians(longitudes) * EQUATORIAL_RADIUS,
                _mercator_y(np.clip(latitudes, -89.9, 89.9)),
            )
        a, _, x0, _, e, y0 = self.place
        rows, cols = (y - y0) / e, (self._turned(x) - x0) / a
        return _snapped(rows[:, None]), _snapped(cols[None, :])

    def _on_raster(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        a, b, x0, d, e, y0 = self.place
        with np.errstate(invalid="ignore"):
            x, y = self._turned(x) - x0, y - y0
            determinant = a * e - b * d
            return (a * y - d * x) / determinant, (e * x - b * y) / determinant

    def _turned(self, x: Floats) -> Floats:
        """Return x within half the world of the raster's middle."""
        if not self.world:
            return x
        a, b, x0, *_ = self.place
        rows, cols = self.shape
        west = x0 + (a * (cols - 1) + b * (rows - 1)) / 2.0 - self.world / 2.0
        with np.errstate(invalid="ignore"):
            return x - np.floor((x - west) / self.world) * self.world

    def of_nodes(self, nodes: Nodes, rows: Span, cols: Span) -> tuple[Floats, Floats]:
        """Return rows and columns of a window of nodes: (n, m) both, or (n, 1) and (1, m)."""
        if self.is_separable:
            return self.axes(nodes.longitudes(np.arange(*cols)), nodes.latitudes(np.arange(*rows)))
        found = smooth(self.at, nodes, rows, cols, _LARGEST_ERROR)
        return _snapped(found[0]), _snapped(found[1])

    def to_world(self, rows: Floats, cols: Floats) -> tuple[Floats, Floats]:
        """Return longitudes and latitudes of places on the raster."""
        import pyproj

        a, b, x0, d, e, y0 = self.place
        inverse = pyproj.enums.TransformDirection.INVERSE
        x, y = x0 + a * cols + b * rows, y0 + d * cols + e * rows
        lon, lat = _transformer(self.wkt).transform(x, y, direction=inverse)
        return np.asarray(lon), np.asarray(lat)

    def outline(self) -> tuple[Floats, Floats]:
        """Return longitudes and latitudes of points all over the raster's cells, edges included."""
        n_rows, n_cols = self.shape
        fine, coarse = np.linspace(-0.5, 0.5, 257), np.linspace(-0.5, 0.5, 33)
        grids = [np.meshgrid(fine, coarse), np.meshgrid(coarse, fine)]
        cols = np.concatenate([grid[0].ravel() for grid in grids]) * n_cols + (n_cols - 1) / 2.0
        rows = np.concatenate([grid[1].ravel() for grid in grids]) * n_rows + (n_rows - 1) / 2.0
        lon, lat = self.to_world(rows, cols)
        valid = np.isfinite(lon) & np.isfinite(lat)
        return lon[valid], lat[valid]

    def holds(self, longitude: float, latitude: float) -> bool:
        """Return whether a point lies in the raster's cells."""
        rows, cols = self.at(np.array([longitude]), np.array([latitude]))
        n_rows, n_cols = self.shape
        return bool(-0.5 <= rows[0] <= n_rows - 0.5 and -0.5 <= cols[0] <= n_cols - 0.5)

    def cols_of_edges(self, nodes: Nodes) -> tuple[float, float]:
        """Return the columns of nodes at the west and east edges of a separable raster."""
        a, _, x0, *_ = self.place
        edges = sorted(x0 + a * col for col in (-0.5, self.shape[1] - 0.5))
        west, east = (
            (nodes.cols_at(np.array(edges)) + 0.0)
            if self.kind == "degrees"
            else (nodes.cols_at(np.degrees(np.array(edges) / EQUATORIAL_RADIUS)))
        )
        return float(west), float(east)


def _snapped(places: Floats) -> Floats:
    """Move places, where they are, to whole rows and columns within a millionth of a cell."""
    from rtin._kernels.lattices import snap

    snap(places, _SNAP)
    return places


def smooth(
    function: Callable[[Floats, Floats], Sequence[Floats]],
    nodes: Nodes,
    rows: Span,
    cols: Span,
    tolerance: float,
) -> list[Floats]:
    """Return values of a function of longitude and latitude at a window of nodes.

    They are bilinear between control nodes, one in every ``STEP`` of the world's nodes, where twice
    the second differences there bound the error by the tolerance, and the function's own elsewhere.
    Which of the two a node gets depends on its control nodes and their neighbours only, so that it
    has the same bits in every window.
    """
    control_rows, control_cols = _controls(rows), _controls(cols)
    grid = np.meshgrid(nodes.longitudes(control_cols * STEP), nodes.latitudes(control_rows * STEP))
    controls = [np.ascontiguousarray(values) for values in function(*grid)]
    is_rough = ~np.logical_and.reduce([_bound(values) <= tolerance for values in controls])
    found = [_between(values, control_rows, control_cols, rows, cols) for values in controls]
    if is_rough.any():
        exact = _nodes_of(is_rough, control_rows, control_cols, rows, cols)
        row, col = np.nonzero(exact)
        longitudes, latitudes = (
            nodes.longitudes(np.arange(*cols)),
            nodes.latitudes(np.arange(*rows)),
        )
        points = longitudes[col], latitudes[row]
        for values, true in zip(found, function(*points), strict=True):
            values[exact] = true
    return found


def _controls(span: Span) -> NDArray[np.int64]:
    """Return the control nodes on both sides of all nodes of a span, and one more at each end."""
    return np.arange(span[0] // STEP - 1, (span[1] - 1) // STEP + 3)


def _bound(values: Floats) -> Floats:
    """Return a bound of the error of bilinear values in each cell of control nodes.

    An eighth of the second derivatives (times the squared step), by differences at its corners.
    """
    with np.errstate(invalid="ignore"):
        down = np.abs(np.diff(values, 2, axis=0))[:, 1:-1]
        along = np.abs(np.diff(values, 2, axis=1))[1:-1]
        return (_SAFETY / 8.0) * (_largest_of_corners(down) + _largest_of_corners(along))


def _largest_of_corners(values: Floats) -> Floats:
    pairs = np.maximum(values[:-1], values[1:])
    return np.maximum(pairs[:, :-1], pairs[:, 1:])


def _between(
    values: Floats,
    control_rows: NDArray[np.int64],
    control_cols: NDArray[np.int64],
    rows: Span,
    cols: Span,
) -> Floats:
    from rtin._kernels.lattices import fill_between

    found = np.empty((rows[1] - rows[0], cols[1] - cols[0]))
    first_row, first_col = int(control_rows[0]) * STEP, int(control_cols[0]) * STEP
    fill_between(values, first_row - rows[0], first_col - cols[0], STEP, found)
    return found


def _nodes_of(
    is_rough: NDArray[np.bool_],
    control_rows: NDArray[np.int64],
    control_cols: NDArray[np.int64],
    rows: Span,
    cols: Span,
) -> NDArray[np.bool_]:
    """Return which nodes of a window lie in the marked cells of control nodes."""
    row_cell = np.arange(*rows) // STEP - control_rows[1]
    col_cell = np.arange(*cols) // STEP - control_cols[1]
    return is_rough[np.ix_(row_cell, col_cell)]
