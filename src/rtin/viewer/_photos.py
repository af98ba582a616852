"""Pictures from raster files, brought to a lattice in another CRS."""

from __future__ import annotations

import os
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin.grid import places_in
from rtin.io._places import horizontal
from rtin.io.grids import gdal_at_work, open_raster

if TYPE_CHECKING:
    import pyproj

__all__ = ["Photo"]

_DARKEST, _BRIGHTEST = 2.0, 98.0  # percentiles that become black and white
_ANY_CRS = "EPSG:3857"  # where both have none, and so the same


class Photo:
    """A raster file of colours or of shades of grey.

    Three or four bands are red, green, blue and perhaps alpha; of one or two the first is grey, or
    the number of a colour in the file's palette. Anything but bytes is stretched from black to
    white, but for the darkest and the brightest 2 %.

    Parameters
    ----------
    path : path
        What GDAL reads.

    Attributes
    ----------
    name : str
    is_placed : bool
        Whether the file says where the picture lies.

    Raises
    ------
    OSError
        If it can't be read.
    ValueError
        If there is no band, or only ground control points say where the picture lies.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.name = os.fsdecode(path)
        with closing(open_raster(self.name)) as dataset, gdal_at_work(self.name):
            if dataset.count == 0 or np.dtype(dataset.dtypes[0]).kind not in "fiu":
                raise ValueError(f"{self.name}: a picture has at least one band of numbers")
            self.is_placed: bool = dataset.transform != Affine.identity()
            if dataset.gcps[0] and not self.is_placed:
                raise ValueError(
                    f"{self.name} is placed by ground control points only; gdalwarp gives such a "
                    "picture a transform"
                )
            self.shape: tuple[int, int] = dataset.shape
            self._crs, self._place = dataset.crs, dataset.transform
            self._overviews: list[int] = dataset.overviews(1)
            self._palette = _palette(dataset)

    def pixels_in_one(
        self, crs: pyproj.CRS | None, transform: Affine, shape: tuple[int, int]
    ) -> float:
        """Return how many of the picture's pixels lie along one of another lattice, in its middle.

        ``transform`` maps corners of the lattice's pixels to x and y in ``crs``. Raises ValueError
        where the picture can't be brought there.
        """
        from rasterio.warp import transform as moved_to

        row, col = shape[0] / 2, shape[1] / 2
        a, b, x, d, e, y = tuple(transform)[:6]
        cols, rows = np.array([[col, col + 1, col], [row, row, row + 1]])
        ours, theirs = self._both(crs)
        xy = (a * cols + b * rows + x).tolist(), (d * cols + e * rows + y).tolist()
        with gdal_at_work(self.name):
            points = np.column_stack(moved_to(theirs, ours, *xy))
        if not np.isfinite(points).all():
            raise ValueError(f"{self.name} shows nothing of the terrain: it lies elsewhere")
        corner, beside, below = places_in(self._place, points)
        return float(np.sqrt(abs(np.linalg.det([beside - corner, below - corner]))))

    def warped(
        self, crs: pyproj.CRS | None, transform: Affine, shape: tuple[int, int]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return RGB, shape (rows, cols, 3), in another CRS, and where the picture has any.

        ``transform`` maps the corners of pixels. Each pixel is the mean of those that it covers, or
        bilinear between the nearest where it is smaller than they are. Reads an overview where one
        is as fine as what is wanted.
        """
        from rasterio.enums import Resampling
        from rasterio.vrt import WarpedVRT

        ours, theirs = self._both(crs)
        times = self.pixels_in_one(crs, transform, shape)
        smooth = Resampling.average if times > 1.0 else Resampling.bilinear
        with closing(self._at(times)) as dataset, gdal_at_work(self.name):
            options = {"height": shape[0], "width": shape[1], "add_alpha": _lacks_mask(dataset)}
            resampling = Resampling.nearest if self._palette is not None else smooth
            with WarpedVRT(
                dataset, src_crs=ours, crs=theirs, transform=transform, resampling=resampling,
                **options,
            ) as warped:  # fmt: skip
                return self._colours(warped, _bands(dataset), shape)

    def whole(self, most: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return RGB of all the picture, of so many rows and columns at most, and where it is."""
        from rasterio.enums import Resampling

        rows, cols = (min(pair) for pair in zip(self.shape, most, strict=True))
        resampling = Resampling.nearest if self._palette is not None else Resampling.average
        times = min(self.shape[0] / rows, self.shape[1] / cols)
        with closing(self._at(times)) as dataset, gdal_at_work(self.name):
            return self._colours(dataset, _bands(dataset), (rows, cols), resampling=resampling)

    def _both(self, crs: pyproj.CRS | None) -> tuple[Any, Any]:
        """Return the picture's CRS and another one, for rasterio; a missing one is the other."""
        from rasterio.crs import CRS

        if crs is None and self._crs:
            raise ValueError(
                f"{self.name} has a CRS and the terrain has none, so where the picture lies on it "
                "is unknown; give the terrain its CRS, for example with gdal_edit.py -a_srs"
            )
        theirs = CRS.from_user_input(_ANY_CRS if crs is None else horizontal(crs).to_wkt())
        return self._crs or theirs, theirs

    def _at(self, times: float) -> Any:  # noqa: ANN401  (rasterio has no types)
        """Return the coarsest dataset whose pixels are at most so many times as wide."""
        fine = [number for number, factor in enumerate(self._overviews) if factor <= times]
        return open_raster(self.name, n_threads="ALL_CPUS", overview=fine[-1] if fine else None)

    def _colours(
        self,
        dataset: Any,  # noqa: ANN401
        bands: list[int],
        shape: tuple[int, int],
        **options: Any,  # noqa: ANN401
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        values = dataset.read(bands, out_shape=(len(bands), *shape), **options)
        covered = _covered(dataset, shape)
        if self._palette is not None:
            rgba = self._palette[values[0]]
            return rgba[:, :, :3], covered & (rgba[:, :, 3] != 0)
        if values.dtype.kind == "f":
            covered &= np.isfinite(values).all(axis=0)
        rgb = np.broadcast_to(_as_bytes(values, covered), (3, *shape))
        return np.ascontiguousarray(np.moveaxis(rgb, 0, -1)), covered


def _bands(dataset: Any) -> list[int]:  # noqa: ANN401
    return [1, 2, 3] if dataset.count >= 3 else [1]


def _palette(dataset: Any) -> NDArray[np.uint8] | None:  # noqa: ANN401
    """Return 256 colours, RGBA, where bytes are numbers of colours."""
    from rasterio.enums import ColorInterp

    if dataset.count > 1 or dataset.colorinterp[0] != ColorInterp.palette:
        return None
    if dataset.dtypes[0] != "uint8":
        return None
    palette = np.zeros((256, 4), np.uint8)
    for number, colour in dataset.colormap(1).items():
        palette[number] = colour
    return palette


def _covered(dataset: Any, shape: tuple[int, int]) -> NDArray[np.bool_]:  # noqa: ANN401
    """Return where a dataset has something; GDAL's own mask knows the alpha of bytes only."""
    from rasterio.enums import ColorInterp

    covered = dataset.dataset_mask(out_shape=shape) != 0
    for band, meaning in zip(dataset.indexes, dataset.colorinterp, strict=True):
        if meaning == ColorInterp.alpha:
            covered &= dataset.read(band, out_shape=shape) != 0
    return np.asarray(covered)


def _lacks_mask(dataset: Any) -> bool:  # noqa: ANN401
    """Return whether nothing would tell what lies outside of the picture."""
    from rasterio.enums import ColorInterp

    return dataset.nodata is None and ColorInterp.alpha not in dataset.colorinterp


def _as_bytes(values: NDArray[Any], covered: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return bands, shape (n, rows, cols), as bytes: stretched, unless they are bytes already."""
    if values.dtype == np.uint8 or not covered.any():
        return values.astype(np.uint8, copy=False)
    seen = values[:, covered]
    low, high = np.percentile(seen, [_DARKEST, _BRIGHTEST])
    shares = (values.astype(np.float64) - low) / ((high - low) or 1.0)
    stretched: NDArray[np.uint8] = np.rint(255.0 * np.nan_to_num(shares).clip(0, 1)).astype(
        np.uint8
    )
    return stretched
