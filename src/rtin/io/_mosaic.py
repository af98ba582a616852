"""Rasters on one grid as one raster, and its heights at the nodes of a tiling scheme."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin._crs import as_crs
from rtin._raster import moved
from rtin.io._places import Nodes, Placement, horizontal
from rtin.io._windows import RasterFile

__all__ = ["Mosaic", "joined"]

_MOST_SAMPLES = 1 << 23  # held at a time for one window
_SAME_GRID = 0.01  # of a cell

Span = tuple[int, int]
Heights = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Mosaic:
    """Rasters whose samples lie on one grid, the first one's; where they overlap, the first counts.

    Attributes
    ----------
    files : tuple of RasterFile
    corners : tuple of (int, int)
        Row and column of each file's first sample.
    """

    files: tuple[RasterFile, ...]
    corners: tuple[tuple[int, int], ...]

    @cached_property
    def placement(self) -> Placement:
        """Where the world lies on the first file's grid."""
        return self._placed(self.files[0].place, self.files[0].shape)

    def _placed(self, place: tuple[float, ...], shape: tuple[int, int]) -> Placement:
        crs = as_crs(self.files[0].wkt)
        assert crs is not None, "a raster without CRS is refused before"
        return Placement(horizontal(crs).to_wkt(), place, shape)

    @cached_property
    def bounds(self) -> tuple[Span, Span]:
        """The rows and columns in which all samples lie."""
        first = np.array(self.corners)
        end = first + [file.shape for file in self.files]
        (top, left), (bottom, right) = first.min(axis=0).tolist(), end.max(axis=0).tolist()
        return (top, bottom), (left, right)

    def whole(self) -> Placement:
        """Return where the world lies on all of the mosaic, from its first row and column."""
        rows, cols = self.bounds
        transform = moved(self.files[0].transform, rows[0], cols[0])
        return self._placed(tuple(transform[:6]), (rows[1] - rows[0], cols[1] - cols[0]))

    def plus(self, file: RasterFile) -> Mosaic | None:
        """Return the mosaic with one file more, None where that is not on its grid."""
        if file.wkt != self.files[0].wkt:
            return None
        corner = _corner(file, self.files[0], self.placement.period)
        if corner is None or not self._is_near(corner[1], file.shape[1]):
            return None
        return replace(self, files=(*self.files, file), corners=(*self.corners, corner))

    def _is_near(self, left: int, n_cols: int) -> bool:
        """Return whether columns have no other place, a turn of the world away, between samples."""
        a, b, _, d, *_ = self.placement.place
        world, period = self.placement.world, self.placement.period
        if not world or period:
            return True
        middle = (self.files[0].shape[1] - 1) / 2.0
        farthest = max(abs(left - 0.5 - middle), abs(left + n_cols - 0.5 - middle))
        return b == 0.0 and d == 0.0 and farthest * abs(a) < world / 2.0

    def samples(self, rows: Span, cols: Span) -> Heights | None:
        """Return the samples of a window, NaN where void, infinite where no file has any.

        None where there is no file at all.
        """
        found = None
        for file, corner in zip(self.files, self.corners, strict=True):
            for turn in self._turns(corner[1], file.shape[1], cols):
                part = _overlap((rows, cols), (corner[0], corner[1] + turn), file.shape)
                if part is None:
                    continue
                if found is None:
                    shape = rows[1] - rows[0], cols[1] - cols[0]
                    found = np.full(shape, np.inf, self._dtype)
                _put(file, part, found)
        return found

    @cached_property
    def _dtype(self) -> np.dtype[Any]:
        return np.result_type(*{file.dtype for file in self.files})

    def _turns(self, left: int, n_cols: int, cols: Span) -> list[int]:
        """Return by how much to move a file so that it meets the columns, once round or more."""
        period = self.placement.period
        if not period:
            return [0]
        first = math.floor((cols[0] - left - n_cols) / period) + 1
        end = math.ceil((cols[1] - left) / period)
        return [turn * period for turn in range(first, end)]

    def heights(
        self, nodes: Nodes, rows: Span, cols: Span, scale: float, rises: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Return the heights of a window of nodes, in parts that need a bounded number of samples.

        ``rises`` are added, shape (n, m) or (1, 1).
        """
        places = self.placement.of_nodes(nodes, rows, cols)
        found = np.empty((rows[1] - rows[0], cols[1] - cols[0]), np.float32)
        self._fill(*places, scale, rises, found)
        return found

    def _fill(
        self,
        rows: NDArray[np.float64],
        cols: NDArray[np.float64],
        scale: float,
        rises: NDArray[np.float64],
        found: NDArray[np.float32],
    ) -> None:
        from rtin._kernels.lattices import fill_heights

        window = self._needed(rows, cols)
        if window is None:
            found[:] = np.nan
            return
        n_rows, n_cols = (end - first for first, end in window)
        if n_rows * n_cols > _MOST_SAMPLES and found.size > 1:
            axis = 0 if found.shape[0] > 1 and n_rows > n_cols // 8 else int(found.shape[1] > 1)
            for half in _halves(found.shape, axis):
                parts = [np.ascontiguousarray(_cut(values, half)) for values in (rows, cols, rises)]
                self._fill(parts[0], parts[1], scale, parts[2], found[half])
            return
        samples = self.samples(*window)
        if samples is None:
            found[:] = np.nan
            return
        heights = np.empty(found.shape, np.float32)
        origin = window[0][0], window[1][0]
        fill_heights(samples, *origin, self.placement.period, rows, cols, scale, rises, heights)
        found[:] = heights

    def _needed(
        self, rows: NDArray[np.float64], cols: NDArray[np.float64]
    ) -> tuple[Span, Span] | None:
        """Return the rows and columns of all samples around some places, where files may be."""
        from rtin._kernels.lattices import extent

        spans = []
        for places, period, bound in (
            (rows, 0, self.bounds[0]),
            (cols, self.placement.period, self.bounds[1]),
        ):
            first, last = extent(places, period)
            if first > last:
                return None
            end = last + 2
            if not period:
                first, end = max(first, bound[0]), min(end, bound[1])
                if first >= end:
                    return None
            spans.append((first, end))
        return spans[0], spans[1]


def joined(files: list[RasterFile]) -> list[Mosaic]:
    """Return mosaics in the order of the files: neighbours in it on one grid are joined."""
    found: list[Mosaic] = []
    for file in files:
        larger = found[-1].plus(file) if found else None
        if larger is None:
            found.append(Mosaic((file,), ((0, 0),)))
        else:
            found[-1] = larger
    return found


def _corner(file: RasterFile, first: RasterFile, period: int) -> tuple[int, int] | None:
    """Return where a file's first sample lies on another file's grid, None if between samples."""
    n_rows, n_cols = file.shape
    inverse, transform = ~first.transform, file.transform
    ends = [(0, 0), (n_cols, 0), (0, n_rows)]
    places = np.array([_apply(inverse, _apply(transform, end)) for end in ends])
    left, top = np.rint(places[0]).tolist()
    wanted = np.array(ends) + np.array([left, top])
    if np.abs(places - wanted).max() > _SAME_GRID:
        return None
    if period:
        left = (left + period // 2) % period - period // 2
    return int(top), int(left)


def _apply(transform: Any, point: tuple[float, float]) -> tuple[float, float]:  # noqa: ANN401
    a, b, x, d, e, y = transform[:6]
    col, row = point
    return x + a * col + b * row, y + d * col + e * row


def _overlap(
    window: tuple[Span, Span], corner: tuple[int, int], shape: tuple[int, int]
) -> tuple[tuple[Span, Span], tuple[slice, slice]] | None:
    """Return the part of a file inside a window, in the file's and in the window's numbers."""
    of_file, of_window = [], []
    for (first, end), start, size in zip(window, corner, shape, strict=True):
        low, high = max(first, start), min(end, start + size)
        if low >= high:
            return None
        of_file.append((low - start, high - start))
        of_window.append(slice(low - first, high - first))
    return (of_file[0], of_file[1]), (of_window[0], of_window[1])


def _put(
    file: RasterFile, part: tuple[tuple[Span, Span], tuple[slice, slice]], found: Heights
) -> None:
    """Read the part of a file, unless all is known there, and put it where it is not."""
    (rows, cols), where = part
    view = found[where]
    unknown = ~np.isfinite(view)
    if unknown.any():
        np.copyto(view, file.read(rows, cols), where=unknown)


def _halves(shape: tuple[int, ...], axis: int) -> list[tuple[slice, slice]]:
    everything, middle = slice(None), shape[axis] // 2
    pair = slice(0, middle), slice(middle, None)
    if axis == 0:
        return [(half, everything) for half in pair]
    return [(everything, half) for half in pair]


def _cut(values: NDArray[Any], part: tuple[slice, slice]) -> NDArray[Any]:
    """Return a part of values that may be the same all along an axis."""
    rows, cols = part
    return values[
        slice(None) if values.shape[0] == 1 else rows, slice(None) if values.shape[1] == 1 else cols
    ]
