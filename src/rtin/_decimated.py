"""Every second, fourth, … node of a lattice, kept on disk."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._atomic import describing
from rtin._raster import widened
from rtin.tiles import HeightLattice, Span

__all__ = ["DecimatedLattice", "Recording"]


@dataclass(frozen=True)
class DecimatedLattice:
    """A ``HeightLattice`` of every ``step``-th node of another, in a sparse file.

    The file holds the bits of the heights, those of NaN turned over, so that what was never written
    is void. Several processes may write to it at once, as long as they agree.
    """

    path: Path
    step: int
    rows: Span
    cols: Span
    period: int | None
    transform: Affine
    crs: Any
    dtype: str

    @classmethod
    def of(cls, lattice: HeightLattice, step: int, path: Path) -> DecimatedLattice:
        """Return an empty one; the file is made, or found as it is."""
        dtype = lattice.read((0, 1), (0, 1)).dtype.str
        period = None if lattice.period is None else lattice.period // step
        rows, cols = (_every(step, span) for span in (lattice.rows, lattice.cols))
        transform = widened(lattice.transform, step)
        decimated = cls(path, step, rows, cols, period, transform, lattice.crs, dtype)
        size = np.dtype(dtype).itemsize * (rows[1] - rows[0]) * (cols[1] - cols[0])
        with describing(path), path.open("ab") as file:
            file.truncate(max(1, size))
        return decimated

    def read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights of a window, in C order; NaN where void or outside."""
        heights = np.full((rows[1] - rows[0], cols[1] - cols[0]), np.nan, self.dtype)
        for ours, theirs in self._shared(rows, cols):
            heights[theirs] = (self._bits[ours] ^ self._nan).view(self.dtype)
        return heights

    def record(self, rows: Span, cols: Span, heights: NDArray[np.floating[Any]]) -> None:
        """Take over what belongs here of a window of the lattice that this one is made from.

        Raises OSError where the file can't be written. Nothing is written through memory that is
        mapped: on a full disk that would end the process.
        """
        first_row, first_col = (-span[0] % self.step for span in (rows, cols))
        part = np.ascontiguousarray(heights[first_row :: self.step, first_col :: self.step])
        row, col = ((span[0] + self.step - 1) // self.step for span in (rows, cols))
        bits = part.view(self._nan.dtype) ^ self._nan
        window = (row, row + len(part)), (col, col + part.shape[1])
        with describing(self.path), self.path.open("r+b", buffering=0) as file:
            for (our_rows, our_cols), theirs in self._shared(*window):
                first = our_rows.start * self._n_cols + our_cols.start
                for number, values in enumerate(bits[theirs]):
                    if not values.any():
                        continue  # all void, as the file is where nothing was written
                    _write(file, (first + number * self._n_cols) * values.itemsize, values)

    def _shared(self, rows: Span, cols: Span) -> Iterator[tuple[Any, Any]]:
        """Yield what a window and the file have in common, as slices of either."""
        for shift in self._shifts(cols):
            moved = cols[0] + shift, cols[1] + shift
            (top, bottom), (left, right) = _overlap(rows, self.rows), _overlap(moved, self.cols)
            if top < bottom and left < right:
                yield (
                    (_slice(top, bottom, self.rows[0]), _slice(left, right, self.cols[0])),
                    (_slice(top, bottom, rows[0]), _slice(left, right, moved[0])),
                )

    def _shifts(self, cols: Span) -> Iterable[int]:
        """Return what takes columns of a window, lap by lap, to those of the file."""
        if self.period is None:
            return (0,)
        first = ((self.cols[0] - cols[1]) // self.period + 1) * self.period
        return range(first, self.cols[1] - cols[0], self.period)

    @cached_property
    def _nan(self) -> NDArray[Any]:
        bits = np.array([np.nan], self.dtype)
        return bits.view(f"u{bits.itemsize}")

    @property
    def _n_cols(self) -> int:
        return self.cols[1] - self.cols[0]

    @cached_property
    def _bits(self) -> NDArray[Any]:
        shape = self.rows[1] - self.rows[0], self._n_cols
        return np.memmap(self.path, self._nan.dtype, "r", shape=shape)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_bits"}


@dataclass(frozen=True)
class Recording:
    """A ``HeightLattice`` that writes what is read of it into decimated ones."""

    lattice: HeightLattice
    decimated: tuple[DecimatedLattice, ...]

    @property
    def rows(self) -> Span:
        """First node and the one after the last where heights may be."""
        return self.lattice.rows

    @property
    def cols(self) -> Span:
        """First node and the one after the last where heights may be."""
        return self.lattice.cols

    @property
    def period(self) -> int | None:
        """Columns of a lattice that goes round the world."""
        return self.lattice.period

    @property
    def transform(self) -> Affine:
        """What maps (col, row) of a node to (x, y)."""
        return self.lattice.transform

    @property
    def crs(self) -> Any:  # noqa: ANN401
        """Coordinate reference system of x and y."""
        return self.lattice.crs

    def read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights of a window, and write every step-th one down."""
        heights = self.lattice.read(rows, cols)
        for decimated in self.decimated:
            decimated.record(rows, cols, heights)
        return heights


def _write(file: FileIO, place: int, values: NDArray[Any]) -> None:
    """Write all values; a disk that fills up takes a part of them first."""
    left = values.data.cast("B")
    file.seek(place)
    while left:
        left = left[file.write(left) :]


def _every(step: int, span: Span) -> Span:
    """Return the first multiple of ``step`` in a span and the one after the last, divided by it."""
    return (span[0] + step - 1) // step, (span[1] - 1) // step + 1


def _overlap(a: Span, b: Span) -> Span:
    return max(a[0], b[0]), min(a[1], b[1])


def _slice(first: int, end: int, origin: int) -> slice:
    return slice(first - origin, end - origin)
