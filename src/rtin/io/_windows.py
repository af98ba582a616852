"""Raster files that stay open, read window by window."""

from __future__ import annotations

import hashlib
import os
import threading
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._raster import NORTH_UP
from rtin.io.grids import (
    check_choice,
    gdal_at_work,
    is_npy,
    look_at,
    open_npy,
    open_raster,
    read_heights,
)

if TYPE_CHECKING:
    import pyproj

__all__ = ["RasterFile", "fingerprint"]

_MOST_OPEN = 64  # per thread
Span = tuple[int, int]


def fingerprint(paths: Iterable[str | os.PathLike[str]]) -> list[str]:
    """Return for each raster a short text that changes when one of its files does.

    It is made from the full names, sizes and times of change of all files that GDAL reads for the
    raster: sidecar files, and the sources of a VRT. A change that keeps size and time of a file, or
    of a source that is no file (``/vsicurl/…``), is not noticed.

    Raises
    ------
    OSError
        If a file does not exist or is not a raster.
    """
    return [_fingerprint(os.fsdecode(path)) for path in paths]


def _fingerprint(name: str) -> str:
    states = []
    for file in sorted(_files(name, set())):
        path = Path(file)
        state = path.stat() if path.exists() else None
        states.append((str(path.resolve()), state and (state.st_size, state.st_mtime_ns)))
    return hashlib.sha256(repr(states).encode()).hexdigest()[:24]


def _files(name: str, found: set[str]) -> set[str]:
    """Add a raster's files, and those of the VRTs among them, to ``found``."""
    if is_npy(name):
        return found | {name}
    with open_raster(name) as dataset:
        fresh = {name, *dataset.files} - found
    found |= fresh
    for file in fresh - {name}:
        if file.lower().endswith(".vrt"):
            found |= _files(file, found)
    return found


@dataclass(frozen=True)
class RasterFile:
    """A raster file, and how its heights are read; a few numbers and names, so that it travels.

    Attributes
    ----------
    name : str
    band : int
    encoding : str
        Found out once for the whole raster, so that all windows are read alike.
    shape : (int, int)
        Rows and columns.
    place : six floats
        Maps (col, row) of a sample to (x, y).
    wkt : str or None
        The CRS, None where the file has none.
    dtype : str
        Of all windows, ``"float32"`` or ``"float64"``.
    """

    name: str
    band: int
    encoding: str
    shape: tuple[int, int]
    place: tuple[float, ...]
    wkt: str | None
    dtype: str
    state: tuple[int, int]

    @classmethod
    def of(cls, path: str | os.PathLike[str], band: int, encoding: str | None) -> RasterFile:
        """Look into a file. Raises what ``read_grid`` raises."""
        check_choice(band, encoding)
        name, band = os.fsdecode(path), int(band)
        if is_npy(name):
            array, encoding = open_npy(name, band, encoding), "none"
            transform, crs, shape, dtype = NORTH_UP, None, array.shape, _npy_dtype(array, name)
        else:
            with open_raster(name) as dataset, gdal_at_work(name):
                transform, crs, dtype, encoding = look_at(dataset, name, band, encoding)
                shape = dataset.shape
        wkt = None if crs is None else crs.to_wkt()
        place = tuple(map(float, transform[:6]))
        return cls(name, band, encoding, shape, place, wkt, dtype.name, _state(name))

    @property
    def transform(self) -> Affine:
        """What maps (col, row) of a sample to (x, y)."""
        return Affine(*self.place)

    @property
    def crs(self) -> pyproj.CRS | None:
        """The CRS, None where the file has none."""
        from rtin._crs import as_crs

        return as_crs(self.wkt)

    def read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights of a window inside the raster; NaN where void.

        Raises OSError, naming file and window, where the file cannot be read, and ValueError for
        infinite heights.
        """
        try:
            values = self._read(rows, cols)
        except OSError as error:
            raise type(error)(f"{error} ({_in_words(rows, cols)})") from None
        if np.isinf(values).any():
            raise ValueError(f"{self.name}: heights must be finite ({_in_words(rows, cols)})")
        return values

    def _read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        opened = _OPEN.get(self)
        if is_npy(self.name):
            values: NDArray[Any] = opened[slice(*rows), slice(*cols)].astype(self.dtype, order="C")
            return values
        with gdal_at_work(self.name):
            return read_heights(opened, self.name, (rows, cols), self.band, self.encoding)


class _OpenFiles(threading.local):
    """The files that this thread has open, the last used ones."""

    def __init__(self) -> None:
        self.files: OrderedDict[tuple[Any, ...], Any] = OrderedDict()

    def get(self, raster: RasterFile) -> Any:  # noqa: ANN401
        # A dataset is for one thread, and not for a forked process, which would share its place in
        # the file. A raster that was written anew is opened anew by who looks into it anew.
        key = os.getpid(), raster.name, raster.band, raster.encoding, raster.state
        if key not in self.files:
            is_array = is_npy(raster.name)
            self.files[key] = (
                open_npy(raster.name, raster.band, raster.encoding)
                if is_array
                else open_raster(raster.name)
            )
            if len(self.files) > _MOST_OPEN:
                self.files.popitem(last=False)
        self.files.move_to_end(key)
        return self.files[key]


_OPEN = _OpenFiles()


def _state(name: str) -> tuple[int, int]:
    path = Path(name)
    found = path.stat() if path.exists() else None
    return (found.st_size, found.st_mtime_ns) if found else (0, 0)


def _npy_dtype(array: NDArray[Any], name: str) -> np.dtype[Any]:
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}: heights must be real numbers, got an array of {array.dtype}")
    is_narrow = array.dtype.itemsize <= 2 or array.dtype.newbyteorder("=") == np.float32
    return np.dtype(np.float32 if is_narrow else np.float64)


def _in_words(rows: Span, cols: Span) -> str:
    return f"rows {rows[0]} to {rows[1]}, columns {cols[0]} to {cols[1]}"
