"""Lattices in memory, or computed when they are read: the arrays of xarray."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin._crs import as_crs
from rtin._raster import padded
from rtin.grid import as_floats, placed, unpacked

__all__ = ["DataArrayLattice"]


class DataArrayLattice:
    """The heights of a two-dimensional ``xarray.DataArray``; a ``HeightLattice``.

    Nothing is computed before it is read, and then only the chunks that a window touches, by Dask's
    scheduler at hand: within a task of a cluster, by the task's own thread.

    Parameters
    ----------
    data : xarray.DataArray
        As ``Grid.from_xarray`` takes it: with the same heights, transform and CRS.

    Raises
    ------
    TypeError, ValueError
        As ``Grid.from_xarray`` does, as far as it can be told without a look at heights.
    """

    def __init__(self, data: Any) -> None:  # noqa: ANN401  (xarray is an extra)
        self._data, self.transform, crs = placed(data)
        if self._data.dtype.kind not in "fiu":
            raise TypeError(f"heights must be real numbers, got an array of {self._data.dtype}")
        self.crs = as_crs(crs)
        self.rows, self.cols = (0, self._data.shape[0]), (0, self._data.shape[1])
        self.period: int | None = None
        self._dtype = _dtype_of(self._data)

    def read(self, rows: tuple[int, int], cols: tuple[int, int]) -> NDArray[np.floating[Any]]:
        """Return the heights of a window, in C order; NaN where void or outside.

        Raises ValueError for whole numbers that float64 can't hold.
        """
        return padded(self._read, (self.rows, self.cols), (rows, cols), self._dtype)

    def _read(self, rows: tuple[int, int], cols: tuple[int, int]) -> NDArray[np.floating[Any]]:
        part = _computed(self._data[slice(*rows), slice(*cols)])
        return as_floats(unpacked(part)).astype(self._dtype, order="C")


def _dtype_of(data: Any) -> type[np.floating[Any]]:  # noqa: ANN401
    """Return the narrowest type that surely holds all heights, as they are or scaled."""
    is_scaled = data.attrs.get("scale_factor", 1) != 1 or data.attrs.get("add_offset", 0) != 0
    is_narrow = data.dtype.itemsize <= 2 or data.dtype == np.float32
    return np.float32 if is_scaled or is_narrow else np.float64


def _computed(data: Any) -> Any:  # noqa: ANN401
    """Return the array in memory. A task that waits for others must not hold a worker's thread."""
    if data.chunks is None or not _is_in_a_task():
        return data.compute()
    import distributed

    if not distributed.futures_of(data):
        return data.compute(scheduler="synchronous")
    with distributed.worker_client():  # some chunks lie in the memory of other workers
        return data.compute()


def _is_in_a_task() -> bool:
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return False
    try:
        distributed.get_worker()
    except ValueError:
        return False
    return True
