"""The grid: heights on a lattice of samples, and where those samples lie."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray

from rtin import _parallel
from rtin._crs import as_crs, metres_per_unit
from rtin._raster import NORTH_UP, extent, moved, row_chunks, scaled

if TYPE_CHECKING:
    import pyproj

__all__ = ["Grid"]

_SNAP = 1e-6  # of a cell
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

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.heights.flags.writeable = False  # which neither pickles nor copies keep

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        rows, cols = self.heights.shape
        return rows, cols

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest x and y of the lattice, and height of a sample, shape (2, 3)."""
        heights = np.nanmin(self.heights), np.nanmax(self.heights)
        places = extent(self.transform, self.shape)
        return np.column_stack([places, heights]).astype(np.float64)

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
        So do xc and yc, the coordinates in two dimensions that rioxarray gives a rotated raster.
        An array without any is taken to lie where rioxarray's transform says, which does not
        follow when such an array is cut or thinned. Without that, too, and without a CRS, it gets
        the transform of a ``Grid``.

        The CRS and the nodata value are read through rioxarray where that is imported. The
        attributes scale_factor and add_offset, which an array has until they are applied, are
        applied as in ``read_grid``, and so rounded to float32.

        Raises
        ------
        ValueError
            If there are not two dimensions, a coordinate is not evenly spaced, or there is a CRS
            but nothing that says where the array lies.
        TypeError
            If it is no DataArray, or its values are not real numbers.
        """
        data, transform, crs = placed(data)
        return cls(unpacked(data), transform, crs)

    def in_metres(self) -> Grid:
        """Return the grid with x and y in metres east and north of its middle, and no CRS.

        For whatever measures distances in space. A degree is as long as on the ellipsoid of the
        CRS at the latitude in the middle of the grid: right there, and off by 0.5 % half a degree
        north of it where the latitude is 45. A grid whose CRS is not geographic is returned as it
        is, in the unit of its CRS.
        """
        if self.crs is None or not self.crs.is_geographic:
            return self
        rows, cols = self.shape
        middle = moved(self.transform, (rows - 1) / 2, (cols - 1) / 2)
        return Grid(self.heights, Metres.around(self.crs, middle.c, middle.f).of(self.transform))

    def places(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return row and column, with fractions, of each point of the world, both of shape (n, 2).

        Points closer than a millionth of a cell to a sample's place are taken to be at it. Raises
        ValueError for an array of another shape.
        """
        return places_in(self.transform, xy)

    def heights_at(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return the height at each point of the world: exact at samples, bilinear between them.

        Parameters
        ----------
        xy : array_like, shape (n, 2)
            In the units of the CRS.

        Returns
        -------
        ndarray of float64, shape (n,)
            NaN outside the raster, and where a sample that counts has no height.
        """
        places = self.places(xy)
        with np.errstate(invalid="ignore"):
            inside = ((places >= 0.0) & (places <= np.subtract(self.shape, 1))).all(axis=1)
        heights = np.full(len(places), np.nan)
        first = np.floor(places[inside]).astype(np.intp)
        share = places[inside] - first
        total = np.zeros(len(first))
        for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = np.abs(1 - down - share[:, 0]) * np.abs(1 - right - share[:, 1])
            row, col = np.minimum(np.add(first, (down, right)), np.subtract(self.shape, 1)).T
            total += np.where(weight > 0.0, weight * self.heights[row, col], 0.0)
        heights[inside] = total
        return heights

    def show(self, *, exaggeration: float = 1.0, max_triangles: int | None = None) -> None:
        """Show the grid in 3-D, in a notebook or in the browser; see ``rtin.show``."""
        from rtin.viewer import notebook

        notebook.show(self, exaggeration=exaggeration, max_triangles=max_triangles)

    def _repr_html_(self) -> str:
        from rtin.viewer import notebook

        return notebook.as_html(self)

    def __repr__(self) -> str:
        rows, cols = self.shape
        crs = "no CRS" if self.crs is None else self.crs.to_string()[:40]
        voids = ", with voids" if self.has_voids else ""
        return f"<Grid {rows} × {cols} {self.heights.dtype}{voids}, {crs}>"


class Metres(NamedTuple):
    """Metres east and north of a point of a geographic CRS.

    ``east`` and ``north`` are those in one unit of x and of y, as in ``Grid.in_metres``.
    """

    x: float
    y: float
    east: float
    north: float

    @classmethod
    def around(cls, crs: pyproj.CRS, x: float, y: float) -> Metres:
        """Return metres as long as they are on the ellipsoid at a point."""
        return cls(x, y, *metres_per_unit(crs, y))

    def of(self, transform: Affine) -> Affine:
        """Return in metres what maps to units of the CRS."""
        a, b, x, d, e, y = tuple(transform)[:6]
        in_units = (a, b, x - self.x, d, e, y - self.y)
        return Affine(*np.multiply(in_units, [self.east] * 3 + [self.north] * 3).tolist())

    def undone(self) -> Affine:
        """Return what maps metres to units of the CRS."""
        return Affine(1.0 / self.east, 0.0, self.x, 0.0, 1.0 / self.north, self.y)


def places_in(transform: Affine, xy: ArrayLike) -> NDArray[np.float64]:
    """Return row and column, with fractions, of points on the lattice of a transform."""
    from rtin._kernels.grid import fill_places

    points = np.asarray(xy, np.float64, order="C")
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"points must have shape (n, 2), got {points.shape}")
    numbers, places = np.array(tuple(transform)[:6]), np.empty(points.shape)
    bands = _parallel.row_bands(len(points))
    _parallel.run(fill_places, [(points, numbers, _SNAP, *band, places) for band in bands])
    return places


def lattice_size(shape: tuple[int, int]) -> int:
    """Return 2**k, the cells along a side of the smallest lattice that covers a raster."""
    return 1 << (max(shape) - 2).bit_length()


def require_grid(grid: Grid) -> Grid:
    """Return ``grid``; raise TypeError where it is something else."""
    if not isinstance(grid, Grid):
        raise TypeError(
            f"a Grid is wanted, got {type(grid).__name__}: wrap heights in rtin.Grid(...)"
        )
    return grid


def _as_heights(values: ArrayLike) -> NDArray[np.floating[Any]]:
    shape = np.shape(values)
    if len(shape) != 2 or min(shape) < 2:
        raise ValueError(
            f"heights must have at least 2 rows and 2 columns, got an array of shape {shape}"
        )
    return np.ascontiguousarray(as_floats(values)).view()


def as_floats(values: ArrayLike) -> NDArray[np.floating[Any]]:
    """Return heights as float32 where that loses nothing, or float64; NaN where masked."""
    mask = np.ma.getmask(values)
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"heights must be real numbers, got an array of {array.dtype}")
    if mask is np.ma.nomask:
        return _narrowest_exact_floats(array)
    # Whatever lies under the mask has no say in the type of the rest: zero fits them all.
    heights = _narrowest_exact_floats(np.where(mask, array.dtype.type(0), array))
    heights[mask] = np.nan
    return heights


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
    n_values = _count_values(require_heights(heights))
    if n_values == 0:
        raise ValueError("heights hold no value at all: every sample is NaN or masked")
    return n_values < heights.size


def require_heights(heights: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return heights; raise ValueError where one is infinite or too large to calculate with."""
    for rows in row_chunks(heights.shape):
        too_large = np.abs(heights[rows]) > _LARGEST_HEIGHT
        if too_large.any():
            row, col = np.argwhere(too_large)[0]
            raise ValueError(
                f"heights must be NaN or at most {_LARGEST_HEIGHT:g} in magnitude, "
                f"got {heights[rows][row, col]:g} at row {rows.start + row}, column {col}; "
                "set such samples to NaN to leave them out"
            )
    return heights


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


def _require_data_array(data: object) -> None:
    xarray = sys.modules.get("xarray")  # where nobody has imported it, nothing is a DataArray
    if xarray is None or not isinstance(data, xarray.DataArray):
        raise TypeError(
            f"an xarray.DataArray is wanted, got a {type(data).__name__}; "
            "an array goes to Grid(), a Dataset must have one variable selected"
        )


def placed(data: Any) -> tuple[Any, Affine, Any]:  # noqa: ANN401
    """Return a DataArray with rows and columns only, its transform and its CRS, if any.

    Raises TypeError and ValueError as ``Grid.from_xarray`` does; no height is looked at.
    """
    _require_data_array(data)
    data = data.squeeze(drop=True)
    if data.ndim != 2:
        raise ValueError(
            f"a DataArray with two dimensions is wanted, got {data.ndim}: {data.dims}; "
            "select one band or time first"
        )
    if data.dims[0] in ("x", "lon", "longitude"):
        data = data.transpose()
    crs = getattr(getattr(data, "rio", None), "crs", None)
    return data, _transform_of(data, has_crs=crs is not None), crs


def unpacked(data: Any) -> NDArray[Any]:  # noqa: ANN401
    """Return a DataArray's heights, masked where nodata, with scale and offset applied."""
    values = np.asarray(data.values)
    nodata = data.rio.nodata if hasattr(data, "rio") else data.attrs.get("_FillValue")
    mask = np.ma.nomask if nodata is None or nodata != nodata else values == nodata
    if values.dtype.kind in "fiu":
        scale, offset = data.attrs.get("scale_factor", 1.0), data.attrs.get("add_offset", 0.0)
        values = scaled(values, np.float64(scale).item(), np.float64(offset).item())
    return np.ma.array(values, mask=mask)


def _transform_of(data: Any, *, has_crs: bool) -> Affine:  # noqa: ANN401
    """Return where the samples of a DataArray lie: by its coordinates, or else by rioxarray."""
    row_dim, col_dim = data.dims
    missing = [dim for dim in data.dims if dim not in data.coords]
    planar = [name for name, coord in data.coords.items() if set(coord.dims) == set(data.dims)]
    if missing and data.size and {"xc", "yc"} <= set(planar):
        return Affine(*_plane(data, "xc"), *_plane(data, "yc"))
    if missing and hasattr(data, "rio") and data.rio.transform() != Affine.identity():
        return moved(data.rio.transform(), 0.5, 0.5)
    if missing and has_crs:
        raise ValueError(
            f"the DataArray has a CRS, but along {' and '.join(map(repr, missing))} neither "
            "coordinates nor a transform; give it coordinates or drop the CRS"
        )
    y0, dy = _origin_and_step(data, row_dim, default_step=-1.0)
    x0, dx = _origin_and_step(data, col_dim, default_step=1.0)
    return Affine(dx, 0.0, x0, 0.0, dy, y0)


def _plane(data: Any, name: str) -> tuple[float, float, float]:  # noqa: ANN401
    """Return a two-dimensional coordinate's steps along columns and rows, and its origin."""
    values = np.asarray(data.coords[name].transpose(*data.dims).values, dtype=np.float64)
    rows, cols = values.shape
    origin = values[0, 0]
    along_cols = (values[0, -1] - origin) / (cols - 1)
    along_rows = (values[-1, 0] - origin) / (rows - 1)
    plane = origin + along_cols * np.arange(cols) + along_rows * np.arange(rows)[:, np.newaxis]
    tolerance = 1e-3 * (abs(along_cols) + abs(along_rows))
    _require_even(np.allclose(values, plane, rtol=0.0, atol=tolerance), name)
    return float(along_cols), float(along_rows), float(origin)


def _origin_and_step(data: Any, dim: str, default_step: float) -> tuple[float, float]:  # noqa: ANN401
    if dim not in data.coords or data.sizes[dim] < 2:
        return 0.0, default_step
    values = np.asarray(data.coords[dim].values, dtype=np.float64)
    step = (values[-1] - values[0]) / (len(values) - 1)
    _require_even(np.allclose(np.diff(values), step, rtol=1e-3, atol=0.0), dim)
    return float(values[0]), float(step)


def _require_even(even: bool, name: str) -> None:
    if not even:
        raise ValueError(
            f"coordinate {name!r} must be evenly spaced; resample the array to a regular grid first"
        )
