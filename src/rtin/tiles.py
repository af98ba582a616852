"""Tiles: a mesh too large for memory, made part by part and without cracks.

A lattice of any size is cut into tiles of 2**j cells. The mesh over all of them is the least RTIN
mesh within the tolerance that keeps every corner of a tile (``rtin.coarsen`` with those corners in
``keep``): with them every tile is a lattice of its own, and two tiles meet in the vertices on their
common border only, each of which needs its apexes on both sides. So tiles are settled alone, and
neighbours exchange the marks of their borders until nothing changes. The least mesh is unique:
neither the order nor the number of workers has a say in it.

Given the final marks of its borders, a tile is made from its own heights alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cache, partial
from itertools import groupby
from math import isfinite
from typing import Any, Protocol

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._number import as_number
from rtin._options import as_height
from rtin.coarsening import lattice_bytes, mesh_of_kept
from rtin.grid import Grid, lattice_size

__all__ = ["HeightLattice", "Settled", "Tile", "Tiling", "checksum", "make_tiles", "settle_borders"]

Span = tuple[int, int]
Place = tuple[int, int]  # row and column of a tile
Edge = tuple[int, int, int]  # of a tile: _NORTH or _WEST, row, column
Borders = dict[Edge, int]  # a bit for each node from west or north, set where the vertex is kept

_NORTH, _WEST = 0, 1
# Along a side of what is settled in one go:
_BLOCK_CELLS = 2048
_MOST_TILES = 64
_MOST_CELLS = 1 << 14  # a tile of so many takes a few GiB
_MOST_READ = 1 << 22  # nodes at a time, where that is more than a row of tiles


class HeightLattice(Protocol):
    """Heights at the nodes of a lattice of any size, read window by window."""

    @property
    def rows(self) -> Span:
        """First row of nodes and the one after the last where heights may be; all else is void."""

    @property
    def cols(self) -> Span:
        """Likewise for columns; the end may lie beyond the period."""

    @property
    def period(self) -> int | None:
        """Columns of a lattice that goes round the world: c and c + period are one node."""

    @property
    def transform(self) -> Affine:
        """What maps (col, row) of a node to (x, y)."""

    @property
    def crs(self) -> Any:  # noqa: ANN401
        """Coordinate reference system of x and y: a pyproj.CRS or None."""

    def read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights of a window, in C order; NaN where void or outside.

        A node's height is the same in every window. All windows have one dtype, float32 or float64.
        """
        ...


@dataclass(frozen=True)
class Tile:
    """One tile's part of the mesh over a lattice.

    Attributes
    ----------
    row, col : int
        Of the tile, from the north-west corner of the lattice.
    cells : int
        Along a side, a power of two.
    rows, cols : ndarray of int32, shape (n,)
        Node of each vertex, 0 to ``cells`` from the tile's north-west corner, in row-major order.
    heights : ndarray of float64, shape (n,)
    slopes : ndarray of float64, shape (n, 2)
        Rise to the east and to the north from one node to the next, by central differences of the
        lattice's heights (one-sided next to voids): a property of the node, so that neighbouring
        tiles agree on it.
    triangles : ndarray of int32, shape (m, 3)
        Counter-clockwise from above; 0 and 1 end the longest edge.
    error : float
        Largest vertical distance of a node of the tile from this mesh, as measured on it.
    """

    row: int
    col: int
    cells: int
    rows: NDArray[np.int32]
    cols: NDArray[np.int32]
    heights: NDArray[np.float64]
    slopes: NDArray[np.float64]
    triangles: NDArray[np.int32]
    error: float


@dataclass(frozen=True)
class Tiling:
    """How a lattice is cut into tiles, and what their meshes promise.

    Attributes
    ----------
    lattice : HeightLattice
    cells : int
        Along a side of a tile: a power of two, at least 2.
    max_error : float
        Every node lies within this vertical distance of the mesh.
    shape : (int, int)
        Rows and columns of tiles that there are at all, whether they have heights or not.
    fill : float or None
        Height of void nodes in tiles that have any height. None leaves the mesh open there, as
        ``coarsen`` does.
    largest_cell : int or None
        A power of two: nodes at its multiples are kept whatever the error, as where straight edges
        must follow a round globe. None keeps the corners of tiles only.

    Raises
    ------
    TypeError
        If one is of the wrong kind.
    ValueError
        If ``cells`` is no power of two from 2 to 16384, ``max_error`` negative or NaN, ``shape``
        empty, ``fill`` not finite, ``largest_cell`` no power of two up to ``cells``, or the tiles
        don't go round the lattice's period.
    """

    lattice: HeightLattice
    cells: int
    max_error: float
    shape: tuple[int, int]
    fill: float | None = None
    largest_cell: int | None = None

    def __post_init__(self) -> None:
        require_cells(self.cells)
        as_height("max_error", self.max_error)
        _require_shape(self.shape)
        if self.fill is not None and not isfinite(as_number("fill", self.fill)):
            raise ValueError(f"fill must be None or a finite height, got {self.fill}")
        if self.largest_cell not in (None, *_powers_of_two(self.cells)):
            raise ValueError(
                f"largest_cell must be None or a power of two up to {self.cells}, "
                f"got {self.largest_cell!r}"
            )
        period = self.lattice.period
        if period is not None and period != self.cells * self.shape[1]:
            raise ValueError(
                f"tiles must fit the lattice's period of {period} columns, "
                f"got {self.shape[1]} of {self.cells} cells"
            )

    @classmethod
    def of_raster(cls, lattice: HeightLattice, cells: int, max_error: float) -> Tiling:
        """Return the tiling of a raster's own lattice, which is that of ``coarsen``.

        ``cells`` is the most a tile has: a smaller raster is one tile.

        Raises
        ------
        TypeError, ValueError
            As ``Tiling`` does; ValueError if there are fewer than 2 × 2 nodes.
        """
        require_cells(cells)
        n_rows, n_cols = lattice.rows[1], lattice.cols[1]
        if min(n_rows, n_cols) < 2:
            raise ValueError(
                f"a lattice must have at least 2 rows and 2 columns, got {n_rows} × {n_cols}"
            )
        size = max(lattice_size((n_rows, n_cols)), 2)
        cells = min(cells, size)
        return cls(lattice, cells, max_error, (size // cells, size // cells))

    def tiles(self) -> list[Place]:
        """Return the tiles that may have heights, row by row."""
        n_rows, n_cols = self.shape
        first_row, end_row = self._tiles_across(self.lattice.rows)
        first_col, end_col = self._tiles_across(self.lattice.cols)
        rows = range(max(first_row, 0), min(end_row, n_rows))
        if self.lattice.period is None:
            cols = list(range(max(first_col, 0), min(end_col, n_cols)))
        else:
            cols = sorted({col % n_cols for col in range(first_col, end_col)})
        return [(row, col) for row in rows for col in cols]

    def _tiles_across(self, nodes: Span) -> Span:
        """Return the tiles that hold any of these nodes, on their borders too."""
        first, end = nodes
        return -((self.cells - first) // self.cells), (end - 1) // self.cells + 1

    def edges(self, place: Place) -> tuple[Edge, Edge, Edge, Edge]:
        """Return the northern, southern, western and eastern border of a tile."""
        row, col = place
        east = (_WEST, row, self._column(col + 1))
        return (_NORTH, row, col), (_NORTH, row + 1, col), (_WEST, row, col), east

    def neighbours(self, place: Place) -> tuple[Place | None, ...]:
        """Return the tiles beyond these borders, None where there is none."""
        row, col = place
        beyond = ((row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1))
        inside = ((row, self._column(col)) for row, col in beyond)
        n_rows, n_cols = self.shape
        return tuple(
            place if 0 <= place[0] < n_rows and 0 <= place[1] < n_cols else None for place in inside
        )

    def _column(self, col: int) -> int:
        return col if self.lattice.period is None else col % self.shape[1]

    def read(self, places: Iterable[Place]) -> Iterator[tuple[Place, NDArray[np.floating[Any]]]]:
        """Yield the heights of tiles, each with a ring of one node more; tiles come row by row."""
        for rows, cols in _bands(places, _MOST_READ // self.cells**2):
            spans = [(run[0][1], run[-1][1]) for run in runs([(0, col) for col in cols])]
            windows = [self._window((rows[0], rows[-1]), span) for span in spans]
            for row in rows:
                for (first, last), window in zip(spans, windows, strict=True):
                    top = (row - rows[0]) * self.cells
                    ringed = window[top : top + self.cells + 3]
                    for col in range(first, last + 1):
                        left = (col - first) * self.cells
                        yield (row, col), ringed[:, left : left + self.cells + 3]

    def _window(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights from the first to the last row and column of tiles, and the ring."""
        cells = self.cells
        return self.lattice.read(
            (rows[0] * cells - 1, (rows[1] + 1) * cells + 2),
            (cols[0] * cells - 1, (cols[1] + 1) * cells + 2),
        )


def require_cells(cells: object) -> None:
    """Raise TypeError or ValueError where that can't be the number of cells along a tile's side."""
    if isinstance(cells, bool | np.bool_) or not isinstance(cells, int | np.integer):
        raise TypeError(f"cells must be a whole number, got {cells!r}")
    if not 2 <= cells <= _MOST_CELLS or cells & (cells - 1):
        raise ValueError(f"cells must be a power of two from 2 to {_MOST_CELLS}, got {cells}")


def _powers_of_two(most: int) -> list[int]:
    return [1 << exponent for exponent in range(most.bit_length())]


def _require_shape(shape: Any) -> None:  # noqa: ANN401
    is_pair = isinstance(shape, tuple) and len(shape) == 2
    if not is_pair or not all(isinstance(n, int | np.integer) and n >= 1 for n in shape):
        raise ValueError(f"shape must be two whole numbers from 1 on, got {shape!r}")


@dataclass(frozen=True)
class Settled:
    """What is known of a tiling once its borders are settled.

    Attributes
    ----------
    borders : dict
        What is kept on each border: (0 for the northern or 1 for the western one, row, column of a
        tile) to a whole number with a bit for each node, from west or from north.
    places : frozenset of (int, int)
        Row and column of the tiles with any height.
    largest_range : float
        Largest difference of heights within a tile.
    """

    borders: Borders
    places: frozenset[Place]
    largest_range: float


def checksum(
    rows: NDArray[np.integer[Any]],
    cols: NDArray[np.integer[Any]],
    heights: NDArray[np.floating[Any]],
    triangles: NDArray[np.integer[Any]],
) -> int:
    """Return a number of 64 bits for a set of triangles on a lattice.

    It is a sum over the triangles of a hash of each one's corners: their rows and columns in the
    whole lattice, and heights. So the sums of all tiles, modulo 2**64, are the sum of the whole
    mesh, however it is cut and in whatever order its parts are made.

    Parameters
    ----------
    rows, cols, heights : ndarray, shape (n,)
    triangles : ndarray of int, shape (m, 3)
        In the order that ``coarsen`` gives: the apex last.
    """
    bits = np.asarray(heights, np.float64).view(np.uint64)
    with np.errstate(over="ignore"):
        places = (np.asarray(rows).astype(np.uint64) << np.uint64(32)) + np.asarray(cols).astype(
            np.uint64
        )
        corners = _mixed(_mixed(places) ^ bits)
        hashes = np.zeros(len(triangles), np.uint64)
        for corner in range(3):
            hashes = _mixed(hashes + corners[triangles[:, corner]])
        return int(hashes.sum())


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return numbers in which every bit depends on every bit (SplitMix64, Steele et al., 2014)."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))


# --- borders ------------------------------------------------------------------------------------


def settle_borders(
    tiling: Tiling,
    *,
    executor: Executor | None = None,
    tell: Callable[[int, int], object] | None = None,
) -> Settled:
    """Return which vertices the mesh keeps on the borders of the tiles.

    Blocks of tiles are settled each by itself, then those whose neighbours keep more vertices on a
    common border once more, until nothing changes. Memory is bounded by one block for each worker.

    Parameters
    ----------
    tiling : Tiling
    executor : concurrent.futures.Executor, optional
        Where the blocks are settled; without one, here, one after the other. It has no influence
        on the result.
    tell : callable, optional
        Called with the number of tiles settled so far and of those in sight.
    """
    run: Callable[..., Iterable[Settled]] = map if executor is None else executor.map
    borders: Borders = {}
    places: set[Place] = set()
    largest_range = 0.0
    pending = _by_block(tiling, tiling.tiles())
    done = 0
    while pending:
        blocks, todo = list(pending), list(pending.values())
        known = [_known(tiling, block, borders) for block in blocks]
        in_sight = done + sum(map(len, todo))
        found: dict[Place, Borders] = {}
        parts = run(partial(settle_block, tiling), blocks, todo, known)
        joined = dict(borders)
        for block, part in zip(blocks, parts, strict=True):
            found[block] = part.borders
            for edge, marks in part.borders.items():
                joined[edge] = joined.get(edge, 0) | marks
            places |= part.places
            largest_range = max(largest_range, part.largest_range)
            done += len(pending[block])
            if tell is not None:
                tell(done, in_sight)
        pending = _by_block(tiling, _unaware(tiling, borders, found, joined))
        borders = joined
    return Settled(borders, frozenset(places), largest_range)


def settle_block(tiling: Tiling, block: Place, places: list[Place], known: Borders) -> Settled:
    """Settle some tiles of a block, and those of the block that they have a say in.

    ``known`` is what is known of all borders of the block's tiles. Returns the borders of the tiles
    that were looked at, with more marks than before or as many.
    """
    open_block = _OpenBlock(tiling, block, known)
    open_block.settle(places)
    tiles, borders = open_block.tiles, open_block.borders
    return Settled(
        {edge: borders[edge] for place in tiles for edge in tiling.edges(place)},
        frozenset(place for place, tile in tiles.items() if not tile.is_void),
        max((tile.range for tile in tiles.values()), default=0.0),
    )


class _OpenBlock:
    """The tiles of a block while it is settled."""

    def __init__(self, tiling: Tiling, block: Place, known: Borders) -> None:
        self._tiling = tiling
        self._block = block
        self.borders = dict(known)
        self.tiles: dict[Place, _OpenTile] = {}
        self._waiting: set[Place] = set()

    def settle(self, places: list[Place]) -> None:
        """Settle these tiles, then all that know less than a neighbour, until none does."""
        self._waiting.update(places)
        unaware: deque[Place] = deque()
        for place, heights in self._tiling.read(places):
            self._open(place, heights)
            unaware.extend(self._exchange(place))
        while unaware:
            place = unaware.popleft()
            if place not in self.tiles:
                for _, heights in self._tiling.read([place]):
                    self._open(place, heights)
            unaware.extend(self._exchange(place))

    def _open(self, place: Place, heights: NDArray[np.floating[Any]]) -> None:
        is_void = np.isnan(heights[1:-1, 1:-1]).all()
        heights = heights if is_void else _filled(self._tiling, heights)
        self.tiles[place] = _OpenTile(self._tiling, place, heights)

    def _exchange(self, place: Place) -> Iterator[Place]:
        """Keep what a tile's borders demand; yield the block's tiles that it demands more of."""
        self._waiting.discard(place)
        tile, edges = self.tiles[place], self._tiling.edges(place)
        tile.keep([self.borders.get(edge, 0) for edge in edges])
        beyond = zip(edges, tile.marks(), self._tiling.neighbours(place), strict=True)
        for edge, marks, neighbour in beyond:
            known = self.borders.get(edge, _given(self._tiling))
            # A tile that goes round the world alone has one border in the west and in the east.
            self.borders[edge] = marks | known
            if marks == known:
                continue
            if neighbour is None or neighbour in self._waiting:
                continue
            if _block_of(self._tiling, neighbour) == self._block:
                self._waiting.add(neighbour)
                yield neighbour


def _unaware(
    tiling: Tiling, before: Borders, found: dict[Place, Borders], joined: Borders
) -> list[Place]:
    """Return the tiles that know less of a border than the tile on its other side.

    Blocks know what they found; those that had nothing to do know what was known before.
    """
    places = set()
    for edge in {edge for borders in found.values() for edge in borders}:
        for place in _beside(tiling, edge):
            known = found.get(_block_of(tiling, place), before)
            if known.get(edge, before.get(edge, _given(tiling))) != joined[edge]:
                places.add(place)
    return sorted(places)


def _given(tiling: Tiling) -> int:
    """Return the marks of a border of which nothing is known: those that all tiles have."""
    return _multiples(tiling.cells, tiling.largest_cell or tiling.cells)


@cache
def _multiples(cells: int, step: int) -> int:
    return sum(1 << node for node in range(0, cells + 1, step))


def _beside(tiling: Tiling, edge: Edge) -> Iterator[Place]:
    """Yield the tiles on both sides of a border."""
    side, row, col = edge
    n_rows, n_cols = tiling.shape
    first = (row - 1, col) if side == _NORTH else (row, tiling._column(col - 1))
    for place in (first, (row, col)):
        if 0 <= place[0] < n_rows and 0 <= place[1] < n_cols:
            yield place


def _block_of(tiling: Tiling, place: Place) -> Place:
    side = _block_side(tiling)
    return place[0] // side, place[1] // side


def _block_side(tiling: Tiling) -> int:
    """Return the tiles along a side of a block."""
    return min(max(1, _BLOCK_CELLS // tiling.cells), _MOST_TILES)


def _by_block(tiling: Tiling, places: Iterable[Place]) -> dict[Place, list[Place]]:
    blocks: dict[Place, list[Place]] = {}
    for place in places:
        blocks.setdefault(_block_of(tiling, place), []).append(place)
    return blocks


def _known(tiling: Tiling, block: Place, borders: Borders) -> Borders:
    """Return what is known of the borders of a block's tiles."""
    side = _block_side(tiling)
    places = (
        (block[0] * side + row, block[1] * side + col) for row in range(side) for col in range(side)
    )
    edges = {edge for place in places for edge in tiling.edges(place)}
    return {edge: borders[edge] for edge in edges if edge in borders}


def runs(places: list[Place]) -> Iterator[list[Place]]:
    """Yield neighbours in a row, as many as come one after the other."""
    for _, run in groupby(enumerate(places), lambda item: (item[1][0], item[1][1] - item[0])):
        yield [place for _, place in run]


def _bands(places: Iterable[Place], most: int) -> Iterator[tuple[list[int], list[int]]]:
    """Yield rows that follow each other and have the same columns: ``most`` tiles, or one row."""
    rows: list[int] = []
    cols: list[int] = []
    for row, tiles in groupby(sorted(places), lambda place: place[0]):
        here = [col for _, col in tiles]
        fits = (len(rows) + 1) * len(here) <= most
        if rows and not (row == rows[-1] + 1 and here == cols and fits):
            yield rows, cols
            rows = []
        rows, cols = [*rows, row], here
    if rows:
        yield rows, cols


# --- one tile -----------------------------------------------------------------------------------


def make_tiles(tiling: Tiling, places: Iterable[Place], borders: Borders) -> Iterator[Tile]:
    """Yield tiles, row by row, given all that is kept on their borders.

    Where ``fill`` is a height, tiles without any are made as well; where it is None, tiles without
    a triangle are left out.
    """
    for place, heights in tiling.read(places):
        tile = make_tile(tiling, place, heights, borders)
        if tile is not None:
            yield tile


def make_tile(
    tiling: Tiling, place: Place, heights: NDArray[np.floating[Any]], borders: Borders
) -> Tile | None:
    """Return one tile given its heights as ``Tiling.read`` yields them; None for no triangle."""
    tile = _OpenTile(tiling, place, _filled(tiling, heights))
    tile.keep([borders.get(edge, 0) for edge in tiling.edges(place)])
    return tile.made()


def _filled(tiling: Tiling, heights: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return heights whose voids have the height that the tiling gives them, if any."""
    if tiling.fill is None:
        return heights
    return np.where(np.isnan(heights), heights.dtype.type(tiling.fill), heights)


class OpenSquare:
    """A square part of a lattice while it is settled, a lattice of its own.

    Its corners are taken for kept: what entails them is not its own business.

    Parameters
    ----------
    heights : ndarray of float32 or float64, shape (cells + 1, cells + 1), in C order
    is_complete : bool
        Whether the settling may go the way of a lattice without voids.
    max_error : float
    kept : ndarray of uint8, optional
        What was kept before, as ``lattice_bytes`` holds it.
    turned : bool
        Whether west and east are exchanged in ``heights``; the borders are always the true ones.
    """

    def __init__(
        self,
        heights: NDArray[np.floating[Any]],
        is_complete: bool,
        max_error: float,
        kept: NDArray[np.uint8] | None = None,
        *,
        turned: bool = False,
    ) -> None:
        self.heights = heights
        self.is_void = bool(np.isnan(heights).all())
        self.cells = cells = len(heights) - 1
        self._is_complete = is_complete
        self._max_error = max_error
        self._turned = turned
        self.kept = lattice_bytes(cells) if kept is None else kept
        self.kept[::cells, : cells + 1 : cells] = 1

    def keep(self, borders: list[int]) -> None:
        """Keep the marked vertices of the northern, southern, western and eastern border."""
        from rtin._kernels.lattice import VERTEX, pack

        work = []
        for marks, (rows, cols) in zip(borders, self._sides, strict=True):
            fresh = marks & ~_bits(self.kept[rows, cols])
            if fresh:
                nodes = _numbers(fresh)
                work.append(pack(rows[nodes], cols[nodes], VERTEX))
        if work:
            self.settle(np.concatenate(work))

    def marks(self) -> list[int]:
        """Return what is kept on the northern, southern, western and eastern border."""
        return [_bits(self.kept[side]) for side in self._sides]

    def settle(self, work: NDArray[np.int64]) -> None:
        """Keep what the vertices and triangles in ``work`` entail, as far as the borders."""
        from rtin._kernels.coarsening import close_all, settle

        if self.is_void:
            close_all(self.kept, work)
        elif work.size:
            shared = (self.heights, self._is_complete, self._max_error, None, self.kept, None)
            settle(*shared, 0, self.cells + 1, 1, False, work)

    @property
    def _sides(self) -> tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...]:
        return _sides(self.cells, self._turned)


class _OpenTile(OpenSquare):
    """A tile's lattice while it is settled.

    Diagonals of tiles alternate like a checkerboard, those of a lattice of its own don't: an odd
    tile is turned round, west for east, which is a symmetry of all levels below.
    """

    def __init__(self, tiling: Tiling, place: Place, ringed: NDArray[np.floating[Any]]) -> None:
        self._place = place
        self._ringed = ringed
        heights = ringed[1:-1, 1:-1]
        turned = sum(place) % 2 == 1
        own = np.ascontiguousarray(heights[:, ::-1] if turned else heights)
        super().__init__(own, not np.isnan(own).any(), tiling.max_error, turned=turned)
        self.settle(_roots(tiling.cells))
        if tiling.largest_cell is not None:
            self.settle(_regular(tiling.cells, tiling.largest_cell))

    @property
    def range(self) -> float:
        """Difference of the highest and the lowest height; 0 where there is none."""
        return 0.0 if self.is_void else float(np.nanmax(self.heights) - np.nanmin(self.heights))

    def made(self) -> Tile | None:
        """Return the tile's mesh, None where it has no triangle."""
        from rtin._kernels.tiles import fill_slopes

        if self.is_void:
            return None
        grid = Grid(self.heights)
        try:
            mesh = mesh_of_kept(grid, self.kept)
        except ValueError:
            return None
        rows, cols = -mesh.vertices[:, 1].astype(np.int32), mesh.vertices[:, 0].astype(np.int32)
        triangles, heights = mesh.triangles, mesh.vertices[:, 2]
        if self._turned:
            cols = self.cells - cols
            order = np.lexsort((cols, rows))
            number = np.empty(len(order), np.int32)
            number[order] = np.arange(len(order), dtype=np.int32)
            rows, cols, heights = rows[order], cols[order], heights[order]
            triangles = number[triangles[:, [1, 0, 2]]]
        row, col = self._place
        slopes = np.empty((len(rows), 2))
        fill_slopes(self._ringed, rows, cols, slopes)
        return Tile(
            row, col, self.cells, rows, cols, heights, slopes, triangles, self._largest_error()
        )

    def _largest_error(self) -> float:
        from rtin._kernels.tiles import largest_error

        return float(largest_error(self.heights, self._is_complete, self.kept))


@cache
def _sides(cells: int, turned: bool) -> tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...]:
    """Return rows and columns of the four borders' nodes, in the tile's own lattice."""
    along, first, last = np.arange(cells + 1), np.zeros(cells + 1, int), np.full(cells + 1, cells)
    if turned:
        return (first, along[::-1]), (last, along[::-1]), (along, last), (along, first)
    return (first, along), (last, along), (along, first), (along, last)


@cache
def _regular(cells: int, step: int) -> NDArray[np.int64]:
    """Return every step-th node along both axes of a tile, as work."""
    from rtin._kernels.lattice import VERTEX, pack

    rows, cols = np.mgrid[0 : cells + 1 : step, 0 : cells + 1 : step]
    return pack(rows.ravel(), cols.ravel(), VERTEX)  # type: ignore[no-any-return]


def _roots(cells: int) -> NDArray[np.int64]:
    """Return the two largest triangles of a tile, as work."""
    from rtin._kernels.lattice import pack

    return np.array([pack(0, cells, 2), pack(cells, 0, 1)], np.int64)


def _bits(marks: NDArray[np.uint8]) -> int:
    return int.from_bytes(np.packbits(marks, bitorder="little").tobytes(), "little")


def _numbers(bits: int) -> NDArray[np.intp]:
    """Return the numbers of the bits that are set."""
    length = (bits.bit_length() + 7) // 8
    packed = np.frombuffer(bits.to_bytes(length, "little"), np.uint8)
    return np.flatnonzero(np.unpackbits(packed, bitorder="little"))
