"""Surfaces to measure from and to: meshes, and grids as their finest triangles.

Both are brought into one local system of metres (or of the unit they are in), near its origin, so
that large coordinates cost no digits. A surface is searched through cells (``nearest``), and walked
over piece by piece (``piece``); a grid's triangles are never all there at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin import _parallel
from rtin._crs import metres_per_unit
from rtin._raster import extent
from rtin.grid import Grid
from rtin.mesh import TriangleMesh

__all__ = ["Local", "Piece", "Surface", "local_system", "numbers_in", "surface_of"]

_Floats = NDArray[np.float64]
_Numbers = NDArray[np.int64]

_TRIANGLES_PER_PIECE = 16384
_FEWEST_PIECES = 64  # of a mesh of some size: there may be many samples in each triangle
_FEWEST_TRIANGLES = 16  # in a piece: what its last one leaves of a point is lost
_NO_HEIGHTS = np.empty((0, 0), np.float32)
_NO_NUMBERS = np.empty(0, np.int32)
_NO_MESH = np.empty((0, 3)), np.empty((0, 3), np.int32)


class Local(NamedTuple):
    """Where the local system lies: local = (world - origin) * scale, in x and y.

    Attributes
    ----------
    origin, scale : ndarray of float64, shape (2,)
    extent : float
        Diagonal of the surfaces' bounding box, in the local system, seen from above.
    """

    origin: _Floats
    scale: _Floats
    extent: float

    def transformed(self, transform: Affine) -> Affine:
        """Return the transform from columns and rows to the local system."""
        a, b, x0, d, e, y0 = tuple(transform)[:6]
        (x_scale, y_scale), (x, y) = self.scale.tolist(), self.origin.tolist()
        return Affine(
            *(a * x_scale, b * x_scale, (x0 - x) * x_scale),
            *(d * y_scale, e * y_scale, (y0 - y) * y_scale),
        )

    def from_world(self, points: _Floats) -> _Floats:
        """Return points, shape (n, 3), in the local system."""
        local = np.array(points, np.float64, order="C")
        local[:, :2] = (local[:, :2] - self.origin) * self.scale
        return local

    def to_world(self, points: _Floats) -> _Floats:
        """Return points, shape (n, 3), in the world."""
        world = points.copy()
        world[:, :2] = world[:, :2] / self.scale + self.origin
        return world


class Piece(NamedTuple):
    """Some triangles of a surface, and the edges and corners that are counted to them."""

    vertices: _Floats
    corners: _Numbers
    edges: _Numbers
    triangles: NDArray[np.int32]


@dataclass(frozen=True)
class Surface:
    """A surface in the local system.

    Attributes
    ----------
    n_triangles, n_pieces : int
    piece : callable
        Gives a piece by its number; together they hold each triangle, edge and corner once.
    search : tuple
        What ``_kernels.distance.nearest_on_surface`` takes after the points.
    """

    n_triangles: int
    n_pieces: int
    piece: Callable[[int], Piece]
    search: tuple[Any, ...]

    @property
    def highest(self) -> float:
        """The largest height, up or down from zero."""
        ranges, _ = self.search[2]
        return float(np.abs(ranges[-1]).max())

    def nearest(self, points: _Floats) -> tuple[_Floats, _Numbers]:
        """Return each point's squared distance, and the number of a nearest triangle."""
        from rtin._kernels.distance import nearest_on_surface

        squares, numbers = np.empty(len(points)), np.empty(len(points), np.int64)
        nearest_on_surface(points, *self.search, squares, numbers)
        return squares, numbers


def local_system(*surfaces: TriangleMesh | Grid) -> Local:
    """Return the local system of surfaces: around their middle, in metres if they are in degrees.

    The first CRS found is theirs.
    """
    bounds = np.array([bounds_of(surface) for surface in surfaces])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    middle = (low + high) / 2.0
    crs = next((surface.crs for surface in surfaces if surface.crs is not None), None)
    scale = np.ones(2)
    if crs is not None and crs.is_geographic:
        scale = np.array(metres_per_unit(crs, middle[1]))
    return Local(middle, scale, float(np.hypot(*((high - low) * scale))))


def surface_of(source: TriangleMesh | Grid, local: Local) -> Surface:
    """Return a surface, ready to be searched and walked over."""
    return _of_grid(source, local) if isinstance(source, Grid) else _of_mesh(source, local)


def numbers_in(mesh: TriangleMesh) -> _Numbers:
    """Return the numbers of the vertices that have a triangle, ascending."""
    is_used = np.zeros(mesh.n_vertices, np.bool_)
    is_used[mesh.triangles] = True
    return np.flatnonzero(is_used)


def bounds_of(surface: TriangleMesh | Grid) -> _Floats:
    """Return the least and the largest x and y, in the world, shape (2, 2)."""
    if isinstance(surface, TriangleMesh):
        used = surface.vertices[numbers_in(surface), :2]
        return np.array([used.min(axis=0), used.max(axis=0)])
    return extent(surface.transform, surface.shape)


# --- a mesh -------------------------------------------------------------------------------------


def _of_mesh(mesh: TriangleMesh, local: Local) -> Surface:
    vertices = local.from_world(mesh.vertices)
    n_pieces = max(
        -(-mesh.n_triangles // _TRIANGLES_PER_PIECE),
        min(_FEWEST_PIECES, -(-mesh.n_triangles // _FEWEST_TRIANGLES)),
    )
    corners, edges = numbers_in(mesh), mesh.edges()

    def piece(number: int) -> Piece:
        def share(items: Any) -> Any:  # noqa: ANN401
            return items[len(items) * number // n_pieces : len(items) * (number + 1) // n_pieces]

        return Piece(vertices, share(corners), share(edges), share(mesh.triangles))

    search = _search_of_mesh(vertices, mesh.triangles, vertices[corners, :2])
    return Surface(mesh.n_triangles, n_pieces, piece, search)


def _search_of_mesh(
    vertices: _Floats, triangles: NDArray[np.int32], used: _Floats
) -> tuple[Any, ...]:
    from rtin._kernels.distance import count_members, fill_members

    low, high = used.min(axis=0), used.max(axis=0)
    width = _cell_width(high - low, len(triangles))
    n_cols, n_rows = (np.floor((high - low) / width).astype(np.int64) + 1).tolist()
    places = np.ascontiguousarray((vertices[:, 1::-1] - low[::-1]) / width)
    starts = np.zeros(n_rows * n_cols + 1, np.int64)
    count_members(places, triangles, starts, n_rows, n_cols)
    np.cumsum(starts, out=starts)
    members = np.empty(starts[-1], np.int32)
    lows, highs = _empty_ranges(n_rows, n_cols)
    ends = starts[:-1].copy()
    fill_members(vertices, places, triangles, ends, members, n_rows, n_cols, lows, highs)
    frame = _frame(Affine(width, 0.0, low[0], 0.0, width, low[1]), n_rows, n_cols)
    content = (_NO_HEIGHTS, starts, members, vertices, triangles)
    return content, frame, _blocks(lows, highs)


def _cell_width(extent: _Floats, n_triangles: int) -> float:
    """Return the side of square cells, about as many as triangles.

    Not a round part of the extent: along the edges of a lattice, triangles would be listed on both
    sides.
    """
    longer, shorter = float(extent.max()), float(extent.min())
    width = np.sqrt(longer * max(shorter, longer / n_triangles) / n_triangles)
    return float(width * 1.0123) or 1.0


# --- a grid -------------------------------------------------------------------------------------


def _of_grid(grid: Grid, local: Local) -> Surface:
    from rtin._kernels import sampling

    heights = grid.heights
    n_rows, n_cols = grid.shape[0] - 1, grid.shape[1] - 1
    frame = _frame(local.transformed(grid.transform), n_rows, n_cols)
    per_piece = max(1, _TRIANGLES_PER_PIECE // (2 * n_cols))

    def piece(number: int) -> Piece:
        first, end = number * per_piece, min((number + 1) * per_piece, n_rows)
        n_cells = (end - first) * n_cols
        vertices = np.empty(((end - first + 1) * (n_cols + 1), 3))
        sampling.fill_samples_of_grid(heights, frame, first, end + 1, vertices)
        corners = np.empty(len(vertices), np.int64)
        n_corners = sampling.fill_corners(heights, first, end + (end == n_rows), corners)
        edges = np.empty((5 * n_cells, 2), np.int64)  # that many among voids
        n_edges = sampling.fill_edges_of_cells(heights, first, end, edges)
        triangles = np.empty((2 * n_cells, 3), np.int32)
        n_triangles = sampling.fill_half_cells(heights, first, end, triangles)
        return Piece(vertices, corners[:n_corners], edges[:n_edges], triangles[:n_triangles])

    content = (heights, np.empty(0, np.int64), _NO_NUMBERS, *_NO_MESH)
    search = content, frame, _blocks(*_ranges_of_grid(heights, n_rows, n_cols))
    return Surface(_count_half_cells(heights), -(-n_rows // per_piece), piece, search)


def _ranges_of_grid(heights: NDArray[Any], n_rows: int, n_cols: int) -> tuple[_Floats, _Floats]:
    from rtin._kernels.distance import fill_block_ranges

    lows, highs = _empty_ranges(n_rows, n_cols)
    bands = _parallel.row_bands(len(lows))
    _parallel.run(fill_block_ranges, [(heights, *band, lows, highs) for band in bands])
    return lows, highs


def _count_half_cells(heights: NDArray[Any]) -> int:
    from rtin._kernels.sampling import count_half_cells

    bands = _parallel.row_bands(heights.shape[0] - 1)
    return sum(_parallel.run(count_half_cells, [(heights, *band) for band in bands]))


# --- cells and blocks ---------------------------------------------------------------------------


def _frame(transform: Affine, n_rows: int, n_cols: int) -> _Floats:
    """Return the frame of so many cells, as ``_kernels.distance`` describes it."""
    a, b, x0, d, e, y0 = tuple(transform)[:6]
    determinant = a * e - b * d
    back = np.array([e, -b, -d, a]) / determinant
    column_width = abs(determinant) / np.hypot(b, e)
    row_width = abs(determinant) / np.hypot(a, d)
    is_skew = float(a * b + d * e != 0.0)
    return np.array(
        [x0, y0, a, d, b, e, *back, column_width, row_width, is_skew, n_rows, n_cols], np.float64
    )


def _empty_ranges(n_rows: int, n_cols: int) -> tuple[_Floats, _Floats]:
    from rtin._kernels.distance import BLOCK

    shape = -(-n_rows // BLOCK), -(-n_cols // BLOCK)
    return np.full(shape, np.inf), np.full(shape, -np.inf)


def _blocks(lows: _Floats, highs: _Floats) -> tuple[_Floats, _Numbers]:
    """Return the ranges of all blocks, smallest first, and each level's first, rows and columns."""
    ranges, levels, n_blocks = [], [], 0
    while True:
        ranges.append(np.column_stack([lows.ravel(), highs.ravel()]))
        levels.append((n_blocks, *lows.shape))
        n_blocks += lows.size
        if lows.size == 1:
            return np.concatenate(ranges), np.array(levels, np.int64)
        lows, highs = _of_fours(lows, np.inf).min(axis=2), _of_fours(highs, -np.inf).max(axis=2)


def _of_fours(values: _Floats, filler: float) -> _Floats:
    """Return the values of 2 × 2 neighbours each, shape (rows, cols, 4)."""
    rows, cols = values.shape
    padded = np.pad(values, ((0, rows % 2), (0, cols % 2)), constant_values=filler)
    halves = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2)
    return halves.transpose(0, 2, 1, 3).reshape(*halves.shape[::2], 4)
