"""Coarsening a raster that does not fit in memory, to the same mesh as one that does.

The lattice is cut into blocks of 2**j cells. What lies inside a block, and on its borders, is
settled block by block, as tiles are (``rtin.tiles``), with one difference: no corner of a block is
kept that the least mesh does not keep. The levels above belong to a *frame* of one node for each
corner and each middle of a block::

    o-------o-------o      o corners: their triangles with legs of at least a block's side are
    |       |       |        tested by reading, one after the other, the blocks below, until a
    |   m   |   m   |        sample is out of tolerance
    |       |       |
    o-------o-------o      m middles: all that a block keeps entails its middle, and that two of
    |       |       |        its corners. As soon as it is kept the block is *open*: all its
    |   m   |   m   |        corners are kept, it is a lattice of its own but for the vertices
    |       |       |        on its borders, whose marks it exchanges with its neighbours
    o-------o-------o

Both rules of the least mesh only ever add vertices, and it is unique: the order in which the frame
and the blocks are looked at has no say in the result. A block that is never opened is a part of
large triangles.
"""

from __future__ import annotations

import math
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtin import _parallel
from rtin._distinct import distinct
from rtin._options import as_height
from rtin._raster import NO_TRIANGLE, moved, padded
from rtin.coarsening import coarsen, lattice_bytes, mesh_of_kept
from rtin.criteria import ErrorFigures, error_by_bands
from rtin.grid import Grid, lattice_size
from rtin.mesh import TriangleMesh
from rtin.tiles import Borders, HeightLattice, OpenSquare, Place, Span, Tiling, runs

__all__ = ["LatticeWindow", "coarsen_lattice", "lattice_error", "memory_of_coarsen"]

Tell = Callable[[float], object]
_Heights = NDArray[np.floating[Any]]
_Numbers = NDArray[np.int64]

_USUAL_CELLS, _FEWEST_CELLS = 1024, 64
_LEAST_BLOCKS = 16  # at a time, before they are made smaller
_USUAL_MEMORY = 1 << 30
_MOST_NUMBERS = np.iinfo(np.int32).max
_BYTES_OF_VERTEX = 150  # and of its two triangles
_MOST_ROWS = 512  # of a band to measure
_SETTLING = 0.7  # of the time
_N_BITS = np.array([number.bit_count() for number in range(16)], np.uint8)


def coarsen_lattice(
    lattice: HeightLattice,
    *,
    max_error: float,
    memory: int = _USUAL_MEMORY,
    cells: int | None = None,
    tell: Tell | None = None,
) -> TriangleMesh:
    """Return the least mesh of a raster of any size, read block by block.

    It is the mesh that ``coarsen(grid, max_error=...)`` returns for the same heights: the same
    vertices and triangles in the same order, byte for byte.

    Parameters
    ----------
    lattice : HeightLattice
        Heights from the first node of ``lattice.rows`` and ``lattice.cols`` on, as a raster; it
        does not go round the world, whatever ``lattice.period`` says. Each part is read some three
        times; threads do not read at once.
    max_error : float
        As in ``coarsen``; one number.
    memory : int
        Bytes that the work may take: a third goes to blocks of heights and marks, another one to
        what is being read; and when these are done, 150 for each vertex while the mesh is put
        together. The mesh itself takes some 48. Marks of blocks put aside are compressed to a few
        bits for each vertex kept, and come on top.
    cells : int, optional
        Along a side of a block, a power of two from 2 to 16384. By default 1024, fewer where the
        memory holds less than 16 such blocks. It has no influence on the result.
    tell : callable, optional
        Called with the share of the work that is done, roughly.

    Raises
    ------
    TypeError, ValueError
        As ``coarsen``, ``Grid`` and ``Tiling`` do.
    MemoryError
        If the mesh itself does not fit in ``memory``.
    """
    tolerance = as_height("max_error", max_error)
    raster = _Raster(lattice)
    side = _cells_within(memory, raster.itemsize) if cells is None else cells
    tiling = Tiling.of_raster(raster, side, tolerance)
    if tiling.shape == (1, 1):
        return coarsen(raster.grid(), max_error=tolerance)
    return _joined(_parts(raster, tiling, memory, tell or (lambda _: None)), raster)


def memory_of_coarsen(lattice: HeightLattice) -> int:
    """Return how many bytes ``coarsen`` of it as one grid needs, and measuring that, roughly.

    The mesh is not counted.
    """
    raster = _Raster(lattice)
    nodes_of_lattice = (lattice_size(raster.shape) + 1) ** 2
    return math.prod(raster.shape) * (raster.itemsize + 3) + nodes_of_lattice * 3 // 2


def lattice_error(
    mesh: TriangleMesh,
    lattice: HeightLattice,
    *,
    memory: int = _USUAL_MEMORY,
    look: Callable[[NDArray[np.floating[Any]]], object] | None = None,
    tell: Tell | None = None,
) -> ErrorFigures:
    """Return what ``vertical_error`` does for a raster of any size, read band by band.

    The figures are the same up to the last bits of rms and mean, which are sums in another order;
    rows and columns are counted from the first node of the lattice.

    Parameters
    ----------
    mesh : TriangleMesh
    lattice : HeightLattice
        As in ``coarsen_lattice``; each part is read once.
    memory : int
        Bytes that bands may take; the mesh needs some 28 for each vertex and 4 for each triangle.
    look : callable, optional
        Called with the heights of each band.
    tell : callable, optional
        Called with the share of the work that is done.

    Raises
    ------
    ValueError
        If the mesh covers no valid sample.
    """
    raster = _Raster(lattice)
    n_rows, n_cols = raster.shape
    most = memory // (4 * _parallel.thread_count() * n_cols * (raster.itemsize + 8))
    edges = [*range(0, n_rows, max(1, min(most, _MOST_ROWS))), n_rows]

    def read(first: int, end: int) -> _Heights:
        heights = raster.read((first, end), raster.cols)
        if look is not None:
            look(heights)
        if tell is not None:
            tell(first / n_rows)
        return heights

    return error_by_bands(mesh, raster.transform, list(pairwise(edges)), read)


class LatticeWindow:
    """A part of a lattice as a lattice of its own, void around ``rows`` and ``cols``.

    Raises ValueError where it leaves the lattice. Nodes keep their numbers.
    """

    def __init__(self, lattice: HeightLattice, rows: Span, cols: Span) -> None:
        for part, whole in ((rows, lattice.rows), (cols, lattice.cols)):
            if not whole[0] <= part[0] < part[1] <= whole[1]:
                raise ValueError(
                    f"a window must lie within rows {lattice.rows} and columns {lattice.cols}, "
                    f"got rows {rows} and columns {cols}"
                )
        self.lattice, self.rows, self.cols = lattice, rows, cols
        self.period: int | None = None
        self.transform, self.crs = lattice.transform, lattice.crs
        self.dtype = lattice.read((rows[0], rows[0] + 1), (cols[0], cols[0] + 1)).dtype

    def read(self, rows: Span, cols: Span) -> _Heights:
        """Return the heights of a window."""
        return padded(self.lattice.read, (self.rows, self.cols), (rows, cols), self.dtype)


def _parts(raster: _Raster, tiling: Tiling, memory: int, tell: Tell) -> list[_Part]:
    """Return the mesh in parts: that of the frame, then those of the blocks."""
    blocks = _Blocks(raster, tiling, memory)
    frame = _Frame(blocks)
    frame.settle(lambda share: tell(_SETTLING * share))
    parts, n_vertices = [frame.part()], 0
    for part in frame.parts(lambda share: tell(_SETTLING + (1 - _SETTLING) * share)):
        parts.append(part)
        n_vertices += len(part.keys)
        if _BYTES_OF_VERTEX * n_vertices > memory:
            raise MemoryError(
                f"the mesh has more than {n_vertices} vertices, of {_BYTES_OF_VERTEX} bytes each "
                f"while it is put together, and the limit is {memory / 1e6:.4g} MB; allow a larger "
                "error or more memory"
            )
    return parts


# --- the raster ---------------------------------------------------------------------------------


class _Raster:
    """A lattice's heights as those of a raster: the first node has row and column 0."""

    period: int | None = None

    def __init__(self, lattice: HeightLattice) -> None:
        (first_row, end_row), (first_col, end_col) = lattice.rows, lattice.cols
        self.shape = end_row - first_row, end_col - first_col
        if min(self.shape) < 2:
            raise ValueError(f"a lattice of 2 × 2 nodes or more is wanted, got {self.shape}")
        self.rows, self.cols = (0, self.shape[0]), (0, self.shape[1])
        self.transform = lattice.transform
        if first_row != 0 or first_col != 0:
            self.transform = moved(lattice.transform, first_row, first_col)
        self.crs = lattice.crs
        self._window = LatticeWindow(lattice, lattice.rows, lattice.cols)
        self.itemsize = self._window.dtype.itemsize

    def read(self, rows: Span, cols: Span) -> _Heights:
        """Return the heights of a window, NaN where it is outside."""
        down, right = self._window.rows[0], self._window.cols[0]
        rows, cols = (rows[0] + down, rows[1] + down), (cols[0] + right, cols[1] + right)
        return self._window.read(rows, cols)

    def grid(self) -> Grid:
        """Return all of it as a grid."""
        return Grid(self.read(self.rows, self.cols), self.transform, self.crs)

    @cached_property
    def is_complete(self) -> bool:
        """Whether it fills its lattice: square, 2**k + 1 nodes a side, no voids."""
        size = lattice_size(self.shape)
        if self.shape != (size + 1, size + 1):
            return False
        step = max(1, (1 << 20) // size)
        return not any(
            np.isnan(self.read((row, min(row + step, size + 1)), self.cols)).any()
            for row in range(0, size + 1, step)
        )


# --- blocks -------------------------------------------------------------------------------------


class _Blocks:
    """Open blocks, of which some are at hand and the marks of the others are put aside."""

    def __init__(self, raster: _Raster, tiling: Tiling, memory: int) -> None:
        self.raster = raster
        self.tiling = tiling
        block_bytes = (tiling.cells + 1) ** 2 * (raster.itemsize + 1)
        # A third of the memory; the rest for what is being read, and what the allocator holds.
        self._most = max(2, memory // (3 * block_bytes))
        self.batch = max(1, self._most // 4)
        self._at_hand: OrderedDict[Place, OpenSquare] = OrderedDict()
        self._aside: dict[Place, bytes] = {}

    def __contains__(self, place: Place) -> bool:
        """Whether a block has been opened."""
        return place in self._at_hand or place in self._aside

    def places(self) -> list[Place]:
        """Return the blocks that have been opened, row by row."""
        return sorted({*self._at_hand, *self._aside})

    def is_at_hand(self, place: Place) -> bool:
        """Whether nothing has to be read for a block."""
        return place in self._at_hand

    def heights(self, place: Place) -> _Heights:
        """Return the heights of a block, whether it is open or not."""
        square = self._at_hand.get(place)
        return self._read([place])[0] if square is None else square.heights

    def opened(self, run: list[Place]) -> list[OpenSquare]:
        """Return open blocks, at most a batch, neighbours in a row if any has to be read."""
        missing = [place for place in run if place not in self._at_hand]
        for neighbours in runs(missing):
            for place, heights in zip(neighbours, self._read(neighbours), strict=True):
                self._at_hand[place] = OpenSquare(
                    heights,
                    self.raster.is_complete,
                    self.tiling.max_error,
                    self._taken_up(place),
                )
        for place in run:
            self._at_hand.move_to_end(place)
        while len(self._at_hand) > self._most:
            place, square = self._at_hand.popitem(last=False)
            self._aside[place] = zlib.compress(np.packbits(square.kept).tobytes(), 1)
        return [self._at_hand[place] for place in run]

    def batches(self, places: list[Place]) -> Iterator[list[Place]]:
        """Yield neighbours in a row, at most a batch."""
        for run in runs(places):
            for first in range(0, len(run), self.batch):
                yield run[first : first + self.batch]

    def _read(self, neighbours: list[Place]) -> list[_Heights]:
        """Return the heights of neighbours in a row."""
        cells, (row, first_col) = self.tiling.cells, neighbours[0]
        end_col = (neighbours[-1][1] + 1) * cells + 1
        rows, cols = (row * cells, (row + 1) * cells + 1), (first_col * cells, end_col)
        heights = self.raster.read(rows, cols)
        starts = range(0, len(neighbours) * cells, cells)
        return [np.ascontiguousarray(heights[:, start : start + cells + 1]) for start in starts]

    def _taken_up(self, place: Place) -> NDArray[np.uint8] | None:
        """Return the marks of a block that were put aside."""
        packed = self._aside.pop(place, None)
        if packed is None:
            return None
        kept = lattice_bytes(self.tiling.cells)
        bits = np.frombuffer(zlib.decompress(packed), np.uint8)
        kept.ravel()[:] = np.unpackbits(bits, count=kept.size)
        return kept


# --- the frame ----------------------------------------------------------------------------------


class _Frame:
    """Corners and middles of the blocks: a lattice whose nodes lie half a block apart."""

    def __init__(self, blocks: _Blocks) -> None:
        self._blocks, self._tiling = blocks, blocks.tiling
        self._step = blocks.tiling.cells // 2
        self._size = size = 2 * blocks.tiling.shape[0]
        self._kept = lattice_bytes(size)
        self._kept[::size, : size + 1 : size] = 1
        self._heights = np.full((size + 1, size + 1), np.nan)
        self._is_known = np.zeros((size + 1, size + 1), bool)
        self._untested: list[int] = []
        self._waiting: set[Place] = set()  # blocks that do not know all of their borders
        self._borders: Borders = {}

    # The two rules.

    def settle(self, tell: Tell) -> None:
        """Apply both rules to the frame and the blocks until nothing changes."""
        from rtin._kernels.lattice import pack

        self._untested = [pack(0, self._size, 2), pack(self._size, 0, 1)]
        place, n_settled = (0, 0), 0
        while self._untested or self._waiting:
            while self._untested:
                self._test(self._untested.pop())
            if self._waiting:
                batch = self._next_batch(after=place)
                place = batch[-1]
                self._settle_blocks(batch)
                n_settled += len(batch)
                tell(n_settled / (n_settled + len(self._waiting)))

    def _test(self, triangle: int) -> None:
        """Keep the midpoint of a triangle's hypotenuse if the triangle does not fit."""
        from rtin._kernels.lattice import is_inside, midpoint, spacing_of, unpacked

        row, col, direction = unpacked(triangle)
        middle = midpoint(row, col, spacing_of(row, col), direction)
        if is_inside(*middle, self._size) and not self._kept[middle] and self._fails(triangle):
            self._keep(middle)

    def _keep(self, node: Place) -> None:
        """Keep a node of the frame and all it needs; its triangles are to be tested."""
        from rtin._kernels.lattice import apexes, is_inside, pack, spacing_of

        stack = [node]
        while stack:
            row, col = stack.pop()
            if not is_inside(row, col, self._size) or self._kept[row, col]:
                continue
            self._kept[row, col] = 1
            spacing = spacing_of(row, col)
            p_row, p_col, q_row, q_col = apexes(row, col, spacing)
            stack += [(p_row, p_col), (q_row, q_col)]
            if spacing == 1:
                self._waiting.add((row // 2, col // 2))
            else:
                self._untested += [pack(row, col, direction) for direction in range(4)]

    def _fails(self, triangle: int) -> bool:
        """Return whether a triangle has a valid sample, and one void or out of tolerance."""
        from rtin._kernels.lattice import is_centre, midpoint, spacing_of, unpacked
        from rtin._kernels.out_of_core import see_part
        from rtin._kernels.planes import midpoint_fails, triangle_plane

        row, col, direction = unpacked(triangle)
        spacing = spacing_of(row, col)
        along_axis = is_centre(row, col, spacing)
        self._look_at(self._corners(triangle), midpoint(row, col, spacing, direction))
        shape = (row, col, spacing, direction)
        max_error = self._tiling.max_error
        if midpoint_fails(self._heights, max_error, None, *shape):
            return True
        apex, row_slope, col_slope = triangle_plane(self._heights, *shape, along_axis)
        plane = (apex, row_slope / self._step, col_slope / self._step)
        whole = (row * self._step, col * self._step, spacing * self._step, direction, along_axis)
        has_valid = has_fault = False
        for place in self._blocks_below(whole):
            heights = self._blocks.heights(place)
            corner = (place[0] * self._tiling.cells, place[1] * self._tiling.cells)
            valid, fault = see_part(heights, *corner, *whole, *plane, max_error)
            has_valid, has_fault = has_valid or valid, has_fault or fault
            if has_valid and has_fault:
                return True
        return False

    def _corners(self, triangle: int) -> list[Place]:
        """Return the ends of a triangle's hypotenuse and its apex."""
        from rtin._kernels.lattice import hypotenuse, spacing_of, unpacked

        row, col, direction = unpacked(triangle)
        a_row, a_col, b_row, b_col = hypotenuse(row, col, spacing_of(row, col), direction)
        return [(a_row, a_col), (b_row, b_col), (row, col)]

    def _look_at(self, corners: list[Place], middle: Place) -> None:
        """Read the heights of some nodes, unless that has been done."""
        for row, col in (*corners, middle):
            if not self._is_known[row, col]:
                self._is_known[row, col] = True
                at_row, at_col = row * self._step, col * self._step
                height = self._blocks.raster.read((at_row, at_row + 1), (at_col, at_col + 1))
                self._heights[row, col] = height[0, 0]

    def _blocks_below(self, triangle: tuple[int, int, int, int, bool]) -> Iterator[Place]:
        """Yield the blocks that hold all samples of a triangle between them."""
        from rtin._kernels.lattice import row_spans_of

        cells, apex_row = self._tiling.cells, triangle[0]
        first, last, left, left_step, right, right_step = row_spans_of(*triangle)
        for row in range(first // cells, (last - 1) // cells + 1):
            ends = (max(first, row * cells), min(last, (row + 1) * cells))
            away = [abs(end - apex_row) for end in ends]
            west = min(left + left_step * rows for rows in away)
            east = max(right + right_step * rows for rows in away)
            for col in range(west // cells, (east - 1) // cells + 1):
                yield row, col

    # Blocks.

    def _next_batch(self, after: Place) -> list[Place]:
        """Return waiting blocks: those at hand, else the next ones in row-major order."""
        at_hand = [place for place in self._waiting if self._blocks.is_at_hand(place)]
        if at_hand:
            return sorted(at_hand)[: self._blocks.batch]
        waiting = sorted(self._waiting)
        later = [place for place in waiting if place > after]
        return next(self._blocks.batches(later or waiting))

    def _settle_blocks(self, batch: list[Place]) -> None:
        """Settle blocks, each by itself, and tell the neighbours what is new on their borders."""
        known = [[self._borders.get(edge, 0) for edge in self._tiling.edges(p)] for p in batch]
        squares = self._blocks.opened(batch)
        self._waiting.difference_update(batch)
        _parallel.run(_settle_one, zip(squares, known, strict=True))
        for place, square, before in zip(batch, squares, known, strict=True):
            self._tell_neighbours(place, square, before)

    def _tell_neighbours(self, place: Place, square: OpenSquare, before: list[int]) -> None:
        """Open the blocks beyond borders on which a block keeps more than it was told."""
        between_corners = (1 << self._tiling.cells) - 2
        edges, neighbours = self._tiling.edges(place), self._tiling.neighbours(place)
        for edge, neighbour, marks, known in zip(
            edges, neighbours, square.marks(), before, strict=True
        ):
            new = marks & between_corners & ~known
            self._borders[edge] = self._borders.get(edge, 0) | new
            if new and neighbour is not None:
                self._keep((2 * neighbour[0] + 1, 2 * neighbour[1] + 1))
                self._waiting.add(neighbour)

    # The mesh.

    def part(self) -> _Part:
        """Return the triangles of the frame that are not split."""
        from rtin._kernels.coarsening import present_directions
        from rtin._kernels.lattice import pack, spacing_of

        found = []
        for row, col in np.argwhere(self._kept[::2, : self._size + 1 : 2]) * 2:
            spacing = spacing_of(row, col)
            shared = (self._heights, False, self._kept, row, col, spacing)
            directions = present_directions(*shared)
            found += [pack(row, col, way) for way in range(4) if directions >> way & 1]
        corners = np.array([self._corners(triangle) for triangle in found], np.int64)
        corners = corners.reshape(-1, 3, 2)
        nodes, triangles = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
        heights = self._heights[nodes[:, 0], nodes[:, 1]]
        nodes *= self._step
        return _Part(_keys(nodes[:, 0], nodes[:, 1]), heights, triangles.reshape(-1, 3))

    def parts(self, tell: Tell) -> Iterator[_Part]:
        """Yield the triangles of each open block."""
        cells, places = self._tiling.cells, self._blocks.places()
        done = 0
        for batch in self._blocks.batches(places):
            for (row, col), square in zip(batch, self._blocks.opened(batch), strict=True):
                mesh = _mesh_of(square)
                if mesh is not None:
                    rows = row * cells - mesh.vertices[:, 1].astype(np.int64)
                    cols = col * cells + mesh.vertices[:, 0].astype(np.int64)
                    heights = mesh.vertices[:, 2].copy()
                    yield _Part(_keys(rows, cols), heights, mesh.triangles)
            done += len(batch)
            tell(done / len(places))


def _settle_one(square: OpenSquare, borders: list[int]) -> None:
    from rtin._kernels.lattice import VERTEX, pack

    middle = square.cells // 2
    if not square.kept[middle, middle]:
        square.settle(np.array([pack(middle, middle, VERTEX)], np.int64))
    square.keep(borders)


def _mesh_of(square: OpenSquare) -> TriangleMesh | None:
    """Return the mesh of a block, None where voids leave no triangle."""
    if square.is_void:
        return None
    try:
        return mesh_of_kept(Grid(square.heights), square.kept)
    except ValueError:
        return None


# --- the mesh -----------------------------------------------------------------------------------


class _Part(NamedTuple):
    """Some triangles of the mesh."""

    keys: _Numbers  # of its vertices, in ascending order
    heights: NDArray[np.float64]
    triangles: NDArray[Any]  # numbers among these vertices, the apex last


def _keys(rows: _Numbers, cols: _Numbers) -> _Numbers:
    """Return numbers for nodes that ascend in row-major order."""
    return (rows << 32) | cols


def _joined(parts: list[_Part], raster: _Raster) -> TriangleMesh:
    """Return the mesh of all parts, in the order of ``mesh_of_kept``."""
    n_triangles = sum(len(part.triangles) for part in parts)
    if n_triangles == 0:
        raise ValueError(NO_TRIANGLE)
    keys = distinct(np.concatenate([part.keys for part in parts]))
    if max(len(keys), n_triangles) > _MOST_NUMBERS:
        raise ValueError(
            f"the mesh would have {len(keys)} vertices and {n_triangles} triangles, more than "
            f"{_MOST_NUMBERS}; allow a larger error, or coarsen windows of the raster"
        )
    numbers = [np.searchsorted(keys, part.keys).astype(np.int32) for part in parts]
    vertices = np.empty((len(keys), 3))
    for part, number in zip(parts, numbers, strict=True):
        vertices[number, 2] = part.heights
    a, b, x, d, e, y = tuple(raster.transform)[:6]
    rows, cols = keys >> 32, keys & 0xFFFFFFFF
    vertices[:, 0] = a * cols + b * rows + x
    vertices[:, 1] = d * cols + e * rows + y
    flip = raster.transform.determinant > 0.0
    triangles = _in_order(parts, numbers, len(keys), n_triangles)
    if flip:
        triangles[:, :2] = triangles[:, 1::-1]
    return TriangleMesh(vertices, triangles, raster.crs)


def _in_order(
    parts: list[_Part], numbers: list[NDArray[np.int32]], n_vertices: int, n_triangles: int
) -> NDArray[np.int32]:
    """Return all triangles in row-major order of their apexes, then in that of directions."""
    ways = [_directions(part) for part in parts]
    present = np.zeros(n_vertices, np.uint8)
    for part, number, way in zip(parts, numbers, ways, strict=True):
        for direction in range(4):  # an apex has one triangle in each
            present[number[part.triangles[way == direction, 2]]] |= 1 << direction
    first = np.zeros(n_vertices + 1, np.int64)
    np.cumsum(_N_BITS[present], out=first[1:])
    triangles = np.empty((n_triangles, 3), np.int32)
    for part, number, way in zip(parts, numbers, ways, strict=True):
        own = number[part.triangles]
        before = present[own[:, 2]] & ((1 << way) - 1).astype(np.uint8)
        triangles[first[own[:, 2]] + _N_BITS[before]] = own
    return triangles


def _directions(part: _Part) -> NDArray[np.uint8]:
    """Return the direction from its apex of each triangle, 0 to 3."""
    rows, cols = part.keys >> 32, part.keys & 0xFFFFFFFF
    a, b, apex = part.triangles.T
    down = rows[a] + rows[b] - 2 * rows[apex]
    right = cols[a] + cols[b] - 2 * cols[apex]
    # An axis direction is a diagonal one turned by 45 degrees: turned back.
    along_axis = (down == 0) | (right == 0)
    down, right = (
        np.where(along_axis, down - right, down),
        np.where(along_axis, down + right, right),
    )
    directions: NDArray[np.uint8] = (2 * (down > 0) + (right > 0)).astype(np.uint8)
    return directions


# --- the door -----------------------------------------------------------------------------------


def _cells_within(memory: int, itemsize: int) -> int:
    """Return how large blocks may be for some of them to fit in memory."""
    cells = _USUAL_CELLS
    while cells > _FEWEST_CELLS and 2 * _LEAST_BLOCKS * cells**2 * (itemsize + 1) > memory:
        cells //= 2
    return cells
