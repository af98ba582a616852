"""Colours for terrain: by height, by error, by its relief, or from a photograph laid over it.

A *painter* gives the vertices of a mesh their colours. A *drape* is a picture that lies over a
terrain: sharp on coarse triangles as a texture, and a painter, too.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray

from rtin import _tint
from rtin._number import as_positive
from rtin._raster import moved, widened
from rtin.grid import Grid, places_in, require_grid
from rtin.mesh import TriangleMesh
from rtin.viewer._film import picture_before_film
from rtin.viewer._photos import Photo
from rtin.viewer.opening import Opened

__all__ = ["Drape", "ErrorColours", "Painter", "by_error", "by_height", "hillshade", "orthophoto"]

_Floats = NDArray[np.float64]
Painter = Callable[[TriangleMesh], _Floats]

_LONGEST = 2048  # pixels of a drape, along its longer side: a GLB with it takes about 1 MB more
_QUALITY = 90
_GREY = 160
_AT_A_SAMPLE = 1e-3  # of a cell


@dataclass(frozen=True, eq=False)
class Drape:
    """A picture that lies over a terrain.

    Attributes
    ----------
    image : ndarray of uint8, shape (rows, cols, 3)
        sRGB.
    transform : affine.Affine
        Maps (col, row) of the *centre* of a pixel to (x, y), those of the terrain's surface.
    """

    image: NDArray[np.uint8]
    transform: Affine

    def texture_coordinates(self, points: ArrayLike) -> NDArray[np.float32]:
        """Return u and v, shape (n, 2), for points whose first two columns are x and y.

        As in glTF, u goes from the left edge of the picture to the right one and v from the upper
        to the lower one, 0 to 1.
        """
        rows, cols = self.image.shape[:2]
        places = self._places(points) + 0.5
        return np.clip(places[:, ::-1] / (cols, rows), 0.0, 1.0).astype(np.float32)

    def at(self, points: ArrayLike) -> _Floats:
        """Return colours in 0..1, shape (n, 3), bilinear between the centres of pixels.

        Beyond the outermost centres those colours go on.
        """
        last = np.subtract(self.image.shape[:2], 1)
        places = np.clip(self._places(points), 0.0, last)
        first = places.astype(np.intp)
        then, share = np.minimum(first + 1, last), places - first
        (row, col), (below, right) = first.T, then.T
        down, across = share[:, :1], share[:, 1:]
        upper = self.image[row, col] * (1.0 - across) + self.image[row, right] * across
        lower = self.image[below, col] * (1.0 - across) + self.image[below, right] * across
        return np.asarray((upper * (1.0 - down) + lower * down) / 255.0)

    def __call__(self, mesh: TriangleMesh) -> _Floats:
        """Return colours in 0..1, shape (n, 3), for the vertices of a mesh."""
        return self.at(mesh.vertices)

    @cached_property
    def jpeg(self) -> bytes:
        """The picture as a JPEG for a page, before its film; encoded once."""
        file = io.BytesIO()
        picture_before_film(self.image).save(file, "JPEG", quality=_QUALITY)
        return file.getvalue()

    def _places(self, points: ArrayLike) -> _Floats:
        return places_in(self.transform, np.asarray(points, np.float64)[:, :2])


def by_height(low: float, high: float) -> Painter:
    """Return what tints vertices by height, between the least and the largest there is.

    Greens, browns and white; blues for zero and below where there is land above them.
    """
    return lambda mesh: _tint.tint(mesh.vertices[:, 2], low, high)


@dataclass(frozen=True, eq=False)
class ErrorColours:
    """A painter of errors: pale for none, red and nearly black for as much as is allowed.

    ``allowed`` is in the heights' unit, one for all vertices or one for each; None is the largest
    error of the mesh that is painted.
    """

    grid: Grid
    allowed: float | _Floats | None = None

    def within(self, allowed: float | _Floats) -> ErrorColours:
        """Return the painter for what a mesh was asked to keep; a choice made before stays."""
        return self if self.allowed is not None else ErrorColours(self.grid, allowed)

    def __call__(self, mesh: TriangleMesh) -> _Floats:
        """Return colours in 0..1, shape (n, 3), for the vertices of a mesh."""
        errors = vertex_differences(mesh, self.grid)
        allowed = errors.max(initial=0.0) if self.allowed is None else self.allowed
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.nan_to_num(errors / allowed, posinf=1.0)  # 0 / 0: exact, as was asked
        return _tint.heat(shares)


def by_error(grid: Grid, most: float | None = None) -> ErrorColours:
    """Return what colours vertices by how far a mesh cut from ``grid`` is from its heights there.

    For each triangle two samples are looked at, where there are any: in the middle of its longest
    edge, and halfway from there to its apex. A vertex has the larger difference of all triangles
    around it. That is quick, and no more than a *lower bound* of the largest error, which
    ``vertical_error`` finds in a time that grows with the raster.

    Parameters
    ----------
    grid : Grid
    most : float, optional
        The error shown darkest. By default a page and its pictures take what the mesh was asked to
        keep: the tolerance, or what the pixel error is at each vertex's distance; without
        either it is the largest error of the mesh.

    Raises
    ------
    TypeError
        If ``grid`` is not a Grid.
    ValueError
        If ``most`` is not more than zero.
    """
    require_grid(grid)
    if most is not None:
        most = as_positive("most", most, ", in the heights' unit")
    return ErrorColours(grid, most)


def vertex_differences(mesh: TriangleMesh, grid: Grid) -> _Floats:
    """Return for each vertex the largest difference to the grid that ``by_error`` sees."""
    a, b, apex = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    middle = 0.5 * (a + b)
    inside = 0.5 * (middle + apex)
    of_triangles = np.fmax(_difference(middle, grid), _difference(inside, grid))
    largest = np.zeros(mesh.n_vertices)
    for corner in mesh.triangles.T:
        np.maximum.at(largest, corner, of_triangles)
    return largest


def _difference(points: _Floats, grid: Grid) -> _Floats:
    """Return how far points are from the samples at their places; 0 where there is none."""
    places = places_in(grid.transform, points[:, :2])
    nearest = np.rint(places)
    is_sample = (np.abs(places - nearest) < _AT_A_SAMPLE).all(axis=1)
    row, col = np.clip(nearest, 0, np.subtract(grid.shape, 1)).astype(np.intp).T
    differences = np.abs(points[:, 2] - grid.heights[row, col])
    return np.where(is_sample, np.nan_to_num(differences), 0.0)


def hillshade(grid: Grid, *, longest: int = _LONGEST) -> Drape:
    """Return the relief of all samples of a grid: tinted by height, lit from the north-west.

    Samples are averaged where there are more than ``longest`` along a side; a pixel without any is
    grey. The slopes are exaggerated where the terrain is flat, so brightness is no measure of them.

    Raises
    ------
    TypeError
        If ``grid`` is not a Grid.
    """
    step = -(-max(require_grid(grid).shape) // longest)
    heights = _means(grid.heights, step)
    middle = (step - 1) / 2
    place = widened(moved(grid.transform, middle, middle), step)
    slope_x, slope_y = (slope.ravel() for slope in _tint.slopes(heights, place))
    colours = _tint.relief(heights.ravel(), slope_x, slope_y).reshape(*heights.shape, 4)
    image = np.rint(255.0 * colours[:, :, :3]).astype(np.uint8)
    image[colours[:, :, 3] == 0.0] = _GREY
    return Drape(image, place)


def _means(heights: NDArray[np.floating], step: int) -> _Floats:
    """Return the mean of each step × step heights that there are; NaN where there are none.

    The last row and column may be of fewer, and there are two of each at least.
    """
    if step == 1:
        return heights.astype(np.float64)
    shape = tuple(max(2, -(-size // step)) for size in heights.shape)
    sums, counts = np.zeros(shape), np.zeros(shape, np.int32)
    for row in range(step):
        for col in range(step):
            part = heights[row::step, col::step]
            where = slice(part.shape[0]), slice(part.shape[1])
            counts[where] += part == part
            sums[where] += np.nan_to_num(part)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def orthophoto(
    path: str | os.PathLike[str],
    opened: Opened,
    *,
    longest: int = _LONGEST,
    under: Drape | None = None,
) -> Drape:
    """Return a picture from a file, in the terrain's CRS, over all of its extent.

    Parameters
    ----------
    path : path
        Any raster that GDAL reads, in any CRS: red, green, blue (and alpha), shades of grey, or a
        palette. One with a transform and no CRS is taken to be in the terrain's. One without a
        transform is laid over the whole extent as it is.
    opened : Opened
        The terrain; of any stage.
    longest : int
        Pixels along the longer side, at most; no more than the file has.
    under : Drape, optional
        What is seen where the picture has nothing; grey by default.

    Returns
    -------
    Drape
        From the outermost samples on one side to those on the other. Where the picture lies is
        right to an eighth of its pixels, as GDAL warps.

    Raises
    ------
    OSError
        If the file can't be read.
    ValueError
        If the picture lies elsewhere, or where it lies is unknown: it has a CRS and the terrain has
        none, or ground control points only.
    """
    photo = Photo(path)
    extent = np.maximum(np.ptp(opened.bounds, axis=0), np.finfo(np.float64).tiny)
    finest = extent.max() / longest
    shape = _shape(extent, finest)
    if photo.is_placed:
        # No finer than the picture itself.
        share = photo.pixels_in_one(opened.crs, _in_crs(opened, shape), shape)
        shape = _shape(extent, finest / min(share, 1.0))
        image, covered = photo.warped(opened.crs, _in_crs(opened, shape), shape)
    else:
        image, covered = photo.whole(shape)
    if not covered.any():
        raise ValueError(f"{photo.name} shows nothing of the terrain: it lies elsewhere")
    drape = Drape(image, moved(_corner_transform(opened, image.shape), 0.5, 0.5))
    image[~covered] = _GREY if under is None else _seen_through(under, drape)[~covered]
    return drape


def _shape(extent: _Floats, pixel: float) -> tuple[int, int]:
    """Return rows and columns of square pixels, or nearly, that fill an extent."""
    cols, rows = np.maximum(1, np.ceil(extent / pixel - 1e-3)).astype(int).tolist()
    return rows, cols


def _in_crs(opened: Opened, shape: tuple[int, int]) -> Affine:
    """Return what maps corners of pixels that fill the extent to x and y of the CRS."""
    return _chained(opened.to_crs, _corner_transform(opened, shape))


def _corner_transform(opened: Opened, shape: tuple[int, ...]) -> Affine:
    """Return what maps corners of pixels that fill the extent to x and y of the surface."""
    (west, south), (east, north) = opened.bounds.tolist()
    rows, cols = shape[:2]
    return Affine((east - west) / cols, 0.0, west, 0.0, (south - north) / rows, north)


def _chained(outer: Affine, inner: Affine) -> Affine:
    # Affine's own product is * before version 3 and @ since.
    product = np.array(outer).reshape(3, 3) @ np.array(inner).reshape(3, 3)
    return Affine(*product.ravel()[:6].tolist())


def _seen_through(under: Drape, drape: Drape) -> NDArray[np.uint8]:
    """Return the colours of one drape at the pixels of another."""
    rows, cols = drape.image.shape[:2]
    row, col = np.indices((rows, cols)).reshape(2, -1)
    a, b, x, d, e, y = tuple(drape.transform)[:6]
    points = np.column_stack([a * col + b * row + x, d * col + e * row + y])
    colours = under.at(points).reshape(rows, cols, 3)
    return np.rint(255.0 * colours).astype(np.uint8)
