"""The grid: heights on a lattice of samples, and where those samples lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray

from rtin._crs import as_crs
from rtin._raster import NORTH_UP, row_chunks

if TYPE_CHECKING:
    import pyproj

__all__ = ["Grid"]

# Squares of heights up to this one, and sums of them, stay within float64. A NumPy scalar, so that
# float32 heights are compared with it as float64.
_LARGEST_HEIGHT = np.float64(1e100)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Grid:
    """Heights on a regular lattice of samples.

    Parameters
    ----------
    heights : array_like, shape (rows, cols)
        Heights in any unit; row 0 is north. NaN is void. A masked array's masked samples become
        void. Kept as float32 where that loses nothing, and as float64 otherwise, so that every
        promise about these heights holds for the values given. A float32 or float64 array in C
        order is not copied; do not write to it afterwards.
    transform : affine.Affine or six numbers, optional
        Maps ``(col, row)`` of a sample to ``(x, y)``. A sample sits at the centre of its raster
        cell: n samples span n - 1 cells. By default x is the column and y is minus the row, so
        that the map is seen from above with row 0 in the north.
    crs : pyproj.CRS or anything pyproj takes, optional
        The coordinate reference system of x and y.

    Raises
    ------
    TypeError
        If the heights are not real numbers.
    ValueError
        If there are fewer than 2 × 2 samples, none of them has a height, a height is infinite or
        beyond 1e100 in magnitude, an integer is too large for float64, or the transform is not six
        finite numbers that map the lattice to a plane.
    """

    heights: NDArray[np.floating[Any]]
    transform: Affine
    crs: pyproj.CRS | None
    has_voids: bool = field(init=False)

    def __init__(
        self,
        heights: ArrayLike,
        transform: Affine | Sequence[float] = NORTH_UP,
        crs: Any = None,  # noqa: ANN401
    ) -> None:
        checked = _as_heights(heights)
        checked.flags.writeable = False
        object.__setattr__(self, "heights", checked)
        object.__setattr__(self, "transform", _as_transform(transform))
        object.__setattr__(self, "crs", as_crs(crs))
        object.__setattr__(self, "has_voids", _has_voids(checked))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        rows, cols = self.heights.shape
        return rows, cols

    @property
    def n_samples(self) -> int:
        """Samples that have a height."""
        if not self.has_voids:
            return self.heights.size
        return _count_values(self.heights)

    @classmethod
    def from_xarray(cls, data: Any) -> Grid:  # noqa: ANN401  (xarray is an extra)
        """Return the grid of a two-dimensional ``xarray.DataArray``.

        Rows and columns are its two dimensions, in that order, after singleton ones are dropped;
        the other way round where the first is called x, lon or longitude.
        The coordinates of both, where present, must be evenly spaced; they become the transform.
        The CRS is read through rioxarray where that is installed.

        Raises
        ------
        ValueError
            If there are not two dimensions or a coordinate is not evenly spaced.
        """
        data = data.squeeze(drop=True)
        if data.ndim != 2:
            raise ValueError(
                f"a DataArray with two dimensions is wanted, got {data.ndim}: {data.dims}; "
                "select one band or time first"
            )
        if data.dims[0] in ("x", "lon", "longitude"):
            data = data.transpose()
        row_dim, col_dim = data.dims
        y0, dy = _origin_and_step(data, row_dim, default_step=-1.0)
        x0, dx = _origin_and_step(data, col_dim, default_step=1.0)
        crs = getattr(getattr(data, "rio", None), "crs", None)
        nodata = getattr(getattr(data, "rio", None), "nodata", None)
        heights = np.asarray(data.values)
        if nodata is not None and not np.isnan(nodata):
            heights = np.ma.masked_equal(heights, nodata)
        return cls(heights, Affine(dx, 0.0, x0, 0.0, dy, y0), crs)

    def __repr__(self) -> str:
        rows, cols = self.shape
        crs = "no CRS" if self.crs is None else self.crs.to_string()[:40]
        voids = ", with voids" if self.has_voids else ""
        return f"<Grid {rows} × {cols} {self.heights.dtype}{voids}, {crs}>"


def _as_heights(values: ArrayLike) -> NDArray[np.floating[Any]]:
    mask = np.ma.getmask(values)
    array = np.asarray(values)
    if array.ndim != 2 or min(array.shape) < 2:
        raise ValueError(
            f"heights must have at least 2 rows and 2 columns, got an array of shape {array.shape}"
        )
    if array.dtype.kind not in "fiu":
        raise TypeError(f"heights must be real numbers, got an array of {array.dtype}")
    if mask is np.ma.nomask:
        heights = _narrowest_exact_floats(array)
    else:
        # Whatever lies under the mask has no say in the type of the rest: zero fits them all.
        heights = _narrowest_exact_floats(np.where(mask, array.dtype.type(0), array))
        heights[mask] = np.nan
    return np.ascontiguousarray(heights).view()


def _narrowest_exact_floats(array: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """Return float32 heights where nothing is lost, float64 ones otherwise."""
    native = array.dtype.newbyteorder("=")
    if native == np.float32:
        return array.astype(np.float32, copy=False)
    if array.dtype.itemsize <= 2 and array.dtype.kind in "fiu":
        return array.astype(np.float32)
    if _casts_exactly(array, np.float32):
        return array.astype(np.float32)
    if not _casts_exactly(array, np.float64):
        raise ValueError(
            f"heights of type {array.dtype} do not fit float64 without loss; "
            "subtract an offset or convert them first"
        )
    return array.astype(np.float64, copy=False)


def _casts_exactly(array: NDArray[Any], dtype: type[np.floating[Any]]) -> bool:
    for rows in row_chunks(array.shape):
        chunk = array[rows]
        with np.errstate(over="ignore", invalid="ignore"):
            back = chunk.astype(dtype).astype(array.dtype)
        same = back == chunk
        if array.dtype.kind == "f":
            same |= chunk != chunk
        if not same.all():
            return False
    return True


def _has_voids(heights: NDArray[np.floating[Any]]) -> bool:
    if heights.min() >= -_LARGEST_HEIGHT and heights.max() <= _LARGEST_HEIGHT:
        return False
    for rows in row_chunks(heights.shape):
        too_large = np.abs(heights[rows]) > _LARGEST_HEIGHT
        if too_large.any():
            row, col = np.argwhere(too_large)[0]
            raise ValueError(
                f"heights must be NaN or at most {_LARGEST_HEIGHT:g} in magnitude, "
                f"got {heights[rows][row, col]:g} at row {rows.start + row}, column {col}; "
                "set such samples to NaN to leave them out"
            )
    n_values = _count_values(heights)
    if n_values == 0:
        raise ValueError("heights hold no value at all: every sample is NaN or masked")
    return n_values < heights.size


def _count_values(heights: NDArray[np.floating[Any]]) -> int:
    chunks = (heights[rows] for rows in row_chunks(heights.shape))
    return sum(int(np.count_nonzero(chunk == chunk)) for chunk in chunks)


def _as_transform(value: Any) -> Affine:  # noqa: ANN401
    try:
        transform = Affine(*tuple(value)[:6])
    except (TypeError, ValueError):
        raise ValueError(f"transform must be six numbers (affine.Affine), got {value!r}") from None
    if not np.all(np.isfinite(tuple(transform)[:6])) or transform.determinant == 0.0:
        raise ValueError(
            "transform must map the lattice to a plane: six finite numbers with a*e != b*d, "
            f"got {tuple(transform)[:6]}"
        )
    return transform


def _origin_and_step(data: Any, dim: str, default_step: float) -> tuple[float, float]:  # noqa: ANN401
    if dim not in data.coords or data.sizes[dim] < 2:
        return 0.0, default_step
    values = np.asarray(data.coords[dim].values, dtype=np.float64)
    step = (values[-1] - values[0]) / (len(values) - 1)
    if not np.allclose(np.diff(values), step, rtol=1e-3, atol=0.0):
        raise ValueError(
            f"coordinate {dim!r} must be evenly spaced; resample the array to a regular grid first"
        )
    return float(values[0]), float(step)
