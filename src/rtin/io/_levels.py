"""A raster file at several resolutions: its own samples, thinned out or not, and its overviews."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._raster import NORTH_UP, moved, widened
from rtin.io._thinning import Thinned, n_decoded
from rtin.io.grids import (
    check_choice,
    gdal_at_work,
    holds_codes,
    is_npy,
    open_npy,
    open_raster,
    opened,
    place_of,
    read_grid,
    read_heights,
)

if TYPE_CHECKING:
    import pyproj

__all__ = ["Level", "RasterLevels", "Reading"]


@dataclass(frozen=True)
class Level:
    """The raster itself, where ``overview`` is None, or one of its overviews, 0 the finest."""

    overview: int | None
    shape: tuple[int, int]
    block: tuple[int, int]


@dataclass(frozen=True)
class Reading:
    """Every ``step``-th row and column of a level."""

    level: Level
    step: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of what is read."""
        rows, cols = (-(-size // self.step) for size in self.level.shape)
        return rows, cols

    @property
    def n_samples(self) -> int:
        """Samples that are read."""
        return self.shape[0] * self.shape[1]

    @property
    def window(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """The part of the level that is thinned, so that as much is left out on all sides."""
        firsts = ((size - 1) % self.step // 2 for size in self.level.shape)
        rows, cols = ((first, size) for first, size in zip(firsts, self.level.shape, strict=True))
        return rows, cols

    @property
    def is_possible(self) -> bool:
        """Whether it has the 2 × 2 samples that a grid needs."""
        return min(self.shape) >= 2


@dataclass(frozen=True)
class RasterLevels:
    """What can be read of a raster file, and where it lies; no height has been read yet.

    Attributes
    ----------
    name, band, encoding
        As given to ``of``.
    levels : tuple of Level
        Finest first. Without overviews where colours hold the heights: means of colours hold none.
    transform : affine.Affine
        Maps (col, row) of a sample of the raster itself to (x, y).
    crs : pyproj.CRS or None
    itemsize : int
        Bytes of a sample in the file.
    """

    name: str
    band: int
    encoding: str | None
    levels: tuple[Level, ...]
    transform: Affine
    crs: pyproj.CRS | None
    itemsize: int

    @classmethod
    def of(cls, path: str | os.PathLike[str], band: int, encoding: str | None) -> RasterLevels:
        """Look into a file. Raises what ``read_grid`` raises, as far as no height is needed."""
        check_choice(band, encoding)
        name, band = os.fsdecode(path), int(band)
        if is_npy(name):
            array = open_npy(name, band, encoding)
            level = Level(None, array.shape, (1, array.shape[1]))
            return cls(name, band, encoding, (level,), NORTH_UP, None, array.dtype.itemsize)
        with open_raster(name) as dataset, gdal_at_work(name):
            transform, crs = place_of(dataset, name)
            levels = [Level(None, dataset.shape, dataset.block_shapes[0])]
            if not holds_codes(dataset, encoding):
                levels += _overviews(name, len(dataset.overviews(1)))
            itemsize = np.dtype(dataset.dtypes[min(band, dataset.count) - 1]).itemsize
        return cls(name, band, encoding, tuple(levels), transform, crs, itemsize)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the raster itself."""
        return self.levels[0].shape

    def within(self, most_samples: int, most_decoded: float = np.inf) -> Reading:
        """Return the reading with as many samples as may be, quickest first.

        Of the coarsest level that has a quarter of them at least, thinned out as far as needed so
        that so many samples are read, and decoded. At least 2 × 2 are read.
        """
        rich = [level for level in self.levels if 4 * np.prod(level.shape) >= most_samples]
        return _within(rich[-1] if rich else self.levels[0], most_samples, most_decoded)

    def thinned(self, most_samples: float) -> Reading:
        """Return the reading of the raster's own samples with as many of them as may be."""
        return _within(self.levels[0], most_samples, np.inf)

    def spacing(self, reading: Reading) -> tuple[float, float]:
        """Return how many of the raster's rows, and columns, lie from one sample to the next."""
        rows, cols = (
            reading.step * own / size
            for own, size in zip(self.shape, reading.level.shape, strict=True)
        )
        return rows, cols

    def place(self, reading: Reading) -> Affine:
        """Return what maps (col, row) of a sample that is read to (x, y).

        A sample of an overview lies in the middle of the cells that it stands for.
        """
        along, across = self.spacing(reading)
        (first_row, _), (first_col, _) = reading.window
        middles = (
            (first + 0.5) * step / reading.step - 0.5
            for first, step in ((first_row, along), (first_col, across))
        )
        return widened(moved(self.transform, *middles), along, across)

    def read(
        self, reading: Reading, before_each: Callable[[], None] = lambda: None
    ) -> NDArray[np.floating[Any]]:
        """Return heights; what ``before_each``, called for each part of the file, raises ends it.

        Raises what ``read_grid`` raises.
        """
        if is_npy(self.name):
            return read_grid(self.name, window=reading.window, step=reading.step).heights
        with opened(self.name, reading.level.overview) as dataset:
            thinned = Thinned(dataset, reading.window, reading.step, before_each)
            return read_heights(thinned, self.name, thinned.whole, self.band, self.encoding)


def _within(level: Level, most_samples: float, most_decoded: float) -> Reading:
    reading = Reading(level, 1)
    while (
        reading.n_samples > most_samples
        or n_decoded(level.shape, level.block, reading.step) > most_decoded
    ):
        coarser = Reading(level, reading.step + 1 + reading.step // 64)
        if not coarser.is_possible:
            break
        reading = coarser
    return reading


def _overviews(name: str, n_overviews: int) -> list[Level]:
    found = []
    for number in range(n_overviews):
        with closing(open_raster(name, overview=number)) as dataset:
            found.append(Level(number, dataset.shape, dataset.block_shapes[0]))
    return found
