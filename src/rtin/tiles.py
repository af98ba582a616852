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
from typing import Any, Protocol

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin.coarsening import lattice_bytes, mesh_of_kept
from rtin.grid import Grid, lattice_size

__all__ = ["HeightLattice", "Tile", "Tiling", "checksum", "make_tiles", "settle_borders"]

Span = tuple[int, int]
Place = tuple[int, int]  # row and column of a tile
Edge = tuple[int, int, int]  # of a tile: _NORTH or _WEST, row, column
Borders = dict[Edge, int]  # a bit for each node from west or north, set where the vertex is kept

_NORTH, _WEST = 0, 1
# Along a side of what is settled in one go:
_BLOCK_CELLS = 2048
_MOST_TILES = 64


class HeightLattice(Protocol):
    """Heights at the nodes of a lattice of any size, read window by window.

    Attributes
    ----------
    rows, cols : (int, int)
        First node and the one after the last where heights may be. All else is void.
    period : int or None
        Columns of a lattice that goes round the world: column c and c + period are one node.
    transform : affine.Affine
        Maps (col, row) of a node to (x, y).
    crs : pyproj.CRS or None
    """

    rows: Span
    cols: Span
    period: int | None
    transform: Affine
    crs: Any

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
    """

    lattice: HeightLattice
    cells: int
    max_error: float
    shape: tuple[int, int]
    fill: float | None = None

    @classmethod
    def of_raster(cls, lattice: HeightLattice, cells: int, max_error: float) -> Tiling:
        """Return the tiling of a raster's own lattice, which is that of ``coarsen``.

        ``cells`` is the most a tile has: a smaller raster is one tile.
        """
        size = lattice_size((lattice.rows[1], lattice.cols[1]))
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
        for run in runs(sorted(places)):
            (row, first_col), last_col = run[0], run[-1][1]
            rows = (row * self.cells - 1, (row + 1) * self.cells + 2)
            cols = (first_col * self.cells - 1, (last_col + 1) * self.cells + 2)
            heights = self.lattice.read(rows, cols)
            for place in run:
                start = (place[1] - first_col) * self.cells
                yield place, heights[:, start : start + self.cells + 3]


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
) -> Borders:
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
    run: Callable[..., Iterable[Borders]] = map if executor is None else executor.map
    borders: Borders = {}
    pending = _by_block(tiling, tiling.tiles())
    done = 0
    while pending:
        blocks = list(pending)
        known = [_known(tiling, block, borders) for block in blocks]
        todo = [pending[block] for block in blocks]
        total = done + sum(map(len, todo))
        found: dict[Place, Borders] = {}
        for block, result in zip(
            blocks, run(partial(settle_block, tiling), blocks, todo, known), strict=True
        ):
            found[block] = result
            done += len(pending[block])
            if tell is not None:
                tell(done, total)
        before = {edge: borders.get(edge, 0) for result in found.values() for edge in result}
        for result in found.values():
            for edge, marks in result.items():
                borders[edge] = borders.get(edge, 0) | marks
        unaware = _unaware(tiling, before, found, borders)
        pending = _by_block(tiling, unaware)
    return borders


def settle_block(tiling: Tiling, block: Place, places: list[Place], known: Borders) -> Borders:
    """Settle some tiles of a block, and those of the block that they have a say in.

    Returns the borders of all tiles that were looked at, with the marks ``known`` before.
    """
    borders = dict(known)
    tiles: dict[Place, _OpenTile] = {}
    waiting = set(places)
    unaware: deque[Place] = deque()

    def exchange(place: Place) -> None:
        waiting.discard(place)
        tile, edges = tiles[place], tiling.edges(place)
        tile.keep([borders.get(edge, 0) for edge in edges])
        for edge, neighbour, marks in zip(
            edges, tiling.neighbours(place), tile.marks(), strict=True
        ):
            if marks != borders.get(edge, 0):
                borders[edge] = marks
                if (
                    neighbour is not None
                    and _block_of(tiling, neighbour) == block
                    and neighbour not in waiting
                ):
                    waiting.add(neighbour)
                    unaware.append(neighbour)

    for place, heights in tiling.read(places):
        tiles[place] = _OpenTile(tiling, place, heights)
        exchange(place)
    while unaware:
        place = unaware.popleft()
        if place not in tiles:
            ((_, heights),) = tiling.read([place])
            tiles[place] = _OpenTile(tiling, place, heights)
        exchange(place)
    return {edge: borders[edge] for place in tiles for edge in tiling.edges(place)}


def _unaware(
    tiling: Tiling, before: Borders, found: dict[Place, Borders], borders: Borders
) -> list[Place]:
    """Return the tiles with a border on which the other side keeps more vertices than they know."""
    places = set()
    for edge in before:
        for place in _beside(tiling, edge):
            own = found.get(_block_of(tiling, place), before).get(edge, before[edge])
            if own != borders[edge]:
                places.add(place)
    return sorted(places)


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


# --- one tile -----------------------------------------------------------------------------------


def make_tiles(tiling: Tiling, places: Iterable[Place], borders: Borders) -> Iterator[Tile]:
    """Yield tiles, row by row, given all that is kept on their borders.

    Tiles without a triangle are left out: those without heights, and where ``fill`` is None those
    with no more than voids between them.
    """
    for place, heights in tiling.read(places):
        tile = _OpenTile(tiling, place, heights)
        tile.keep([borders.get(edge, 0) for edge in tiling.edges(place)])
        made = tile.made()
        if made is not None:
            yield made


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
            nodes = _numbers(marks & ~_bits(self.kept[rows, cols]))
            work.append(pack(rows[nodes], cols[nodes], VERTEX))
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
        voids = np.isnan(heights)
        is_void = bool(voids.all())
        if tiling.fill is not None and not is_void:
            self._ringed = np.where(np.isnan(ringed), ringed.dtype.type(tiling.fill), ringed)
            heights = self._ringed[1:-1, 1:-1]
        is_complete = not is_void and (tiling.fill is not None or not voids.any())
        turned = sum(place) % 2 == 1
        heights = np.ascontiguousarray(heights[:, ::-1] if turned else heights)
        super().__init__(heights, is_complete, tiling.max_error, turned=turned)
        self.settle(_roots(tiling.cells))

    def made(self) -> Tile | None:
        """Return the tile's mesh, None where it has no triangle."""
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
        slopes = _slopes(self._ringed, rows, cols)
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


def _slopes(
    ringed: NDArray[np.floating[Any]], rows: NDArray[np.int32], cols: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Return the rise to the east and to the north at some nodes of a tile with its ring."""
    here = ringed[rows + 1, cols + 1].astype(np.float64)
    slopes = np.empty((len(rows), 2))
    for axis, (row_step, col_step) in enumerate(((0, 1), (-1, 0))):
        rise = ringed[rows + 1 + row_step, cols + 1 + col_step] - here
        fall = here - ringed[rows + 1 - row_step, cols + 1 - col_step]
        rise, fall = np.where(np.isnan(rise), fall, rise), np.where(np.isnan(fall), rise, fall)
        slopes[:, axis] = np.nan_to_num((rise + fall) / 2)
    return slopes
