"""Lattices of heights for tests of tiles: an array, read window by window."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._raster import NORTH_UP
from rtin.tiles import checksum


@dataclass(frozen=True)
class ArrayLattice:
    """The nodes of an array; with ``period``, its columns go round the world again and again."""

    heights: NDArray[Any]
    period: int | None = None
    transform: Affine = NORTH_UP
    crs: Any = None
    first: tuple[int, int] = (0, 0)

    @property
    def rows(self):
        return self.first[0], self.first[0] + self.heights.shape[0]

    @property
    def cols(self):
        return self.first[1], self.first[1] + self.heights.shape[1]

    def read(self, rows, cols):
        row = np.arange(*rows) - self.first[0]
        col = np.arange(*cols) - self.first[1]
        if self.period is not None:
            col %= self.period
        n_rows, n_cols = self.heights.shape
        inside = ((row >= 0) & (row < n_rows))[:, None] & ((col >= 0) & (col < n_cols))
        here = self.heights[np.ix_(row.clip(0, n_rows - 1), col.clip(0, n_cols - 1))]
        return np.where(inside, here, self.heights.dtype.type(np.nan))


def decimated(heights, step):
    """Every ``step``-th node in both directions."""
    return np.ascontiguousarray(heights[::step, ::step])


def union(tiles):
    """{(row, col): height} of all vertices, and a set of triangles (a, b, apex) of such places.

    Neighbours must agree on the heights of what they share.
    """
    heights, triangles = {}, []
    for tile in tiles:
        places = places_of(tile)
        for place, height in zip(places, tile.heights.tolist(), strict=True):
            assert heights.setdefault(place, height) == height
        triangles += [tuple(places[corner] for corner in t) for t in tile.triangles.tolist()]
    assert len(set(triangles)) == len(triangles)
    return heights, set(triangles)


def places_of(tile):
    rows = tile.rows.astype(int) + tile.row * tile.cells
    cols = tile.cols.astype(int) + tile.col * tile.cells
    return list(zip(rows.tolist(), cols.tolist(), strict=True))


def union_of_mesh(mesh):
    """The same of a mesh of ``coarsen`` with the transform that a Grid has by default."""
    places = [(-int(y), int(x)) for x, y in mesh.vertices[:, :2].tolist()]
    heights = dict(zip(places, mesh.vertices[:, 2].tolist(), strict=True))
    return heights, {tuple(places[corner] for corner in t) for t in mesh.triangles.tolist()}


def total(tiles):
    """The checksum of all tiles together."""
    sums = (
        checksum(t.rows + t.row * t.cells, t.cols + t.col * t.cells, t.heights, t.triangles)
        for t in tiles
    )
    return sum(sums) % 2**64
