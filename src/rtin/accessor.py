"""``da.rtin``: the terrain functions as methods of an ``xarray.DataArray``.

``import rtin.accessor`` registers them; ``import rtin`` alone does not, so that it need not load
xarray.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from contextlib import suppress
from functools import cached_property, partial
from typing import Any

import numpy as np

from rtin._raster import NO_TRIANGLE
from rtin.coarsening import coarsen
from rtin.grid import Grid
from rtin.io.arrays import DataArrayLattice
from rtin.mesh import TriangleMesh
from rtin.tiles import Borders, Place, Settled, Tile, Tiling, make_tiles, settle_borders

try:
    import xarray
except ImportError:
    raise ImportError("rtin.accessor needs xarray: pip install 'rtin[xarray]'") from None

with suppress(ImportError):
    import rioxarray  # noqa: F401  (gives an array the CRS and the nodata value that Grid reads)

__all__ = ["RtinAccessor", "TileMeshes"]

_MOST_TILES = 16  # made in one go


@xarray.register_dataarray_accessor("rtin")  # type: ignore[no-untyped-call]
class RtinAccessor:
    """The terrain functions of one ``xarray.DataArray``, found at ``da.rtin``."""

    def __init__(self, data: xarray.DataArray) -> None:
        self._data = data

    @property
    def grid(self) -> Grid:
        """The array as a ``Grid``; see ``Grid.from_xarray`` for what it takes and refuses."""
        return Grid.from_xarray(self._data)

    def coarsen(self, **options: Any) -> TriangleMesh:  # noqa: ANN401
        """Return ``rtin.coarsen`` of the array: ``da.rtin.coarsen(max_error=5.0)``.

        Takes the keyword arguments of ``rtin.coarsen`` and raises what that and
        ``Grid.from_xarray`` raise.
        """
        return coarsen(self.grid, **options)

    def coarsen_tiles(
        self, max_error: float, *, cells: int = 512, executor: Executor | None = None
    ) -> TileMeshes:
        """Return the array's mesh in tiles, none of which is made before it is asked for.

        Together they are ``rtin.coarsen`` with the corners of all tiles in ``keep``: neighbours
        share the vertices on their border, and there are no cracks. The array is never in memory as
        a whole: of one that is backed by Dask, only the chunks that a few tiles touch are computed,
        once or more for the borders and once or more for the meshes. ``da.persist()`` what takes
        long to compute; chunks of several tiles a side are computed least often.

        Parameters
        ----------
        max_error : float
            Every valid sample lies within this vertical distance of the surface, in the unit of the
            heights.
        cells : int
            Along a side of a tile: a power of two from 2 to 16384.
        executor : concurrent.futures.Executor, optional
            Where the work is done, as ``rtin.distributed.cluster`` gives one. The result does not
            depend on it.

        Raises
        ------
        TypeError, ValueError
            As ``Grid.from_xarray`` does, and for a negative or NaN ``max_error`` or for ``cells``
            that are no such number. What is wrong with heights is raised when they are read.
        """
        lattice = DataArrayLattice(self._data)
        return TileMeshes(Tiling.of_raster(lattice, cells, max_error), executor)


class TileMeshes:
    """The meshes of an array's tiles, made when they are asked for.

    Iterating yields a ``TriangleMesh`` for each tile with a triangle, in the array's CRS, row by
    row; ``[row, col]`` gives the mesh of one tile, counted from the north-west::

        tiles = da.rtin.coarsen_tiles(max_error=5.0)
        for row, col in tiles.places:
            rtin.write_mesh(tiles[row, col], f"{row}-{col}.glb")

    The first of them needs the borders of all tiles settled, which takes about half of the time.

    Attributes
    ----------
    tiling : rtin.tiles.Tiling
    """

    def __init__(self, tiling: Tiling, executor: Executor | None = None) -> None:
        self.tiling = tiling
        self._executor = executor

    @cached_property
    def settled(self) -> Settled:
        """What is kept on the borders of tiles, and where there are heights."""
        return settle_borders(self.tiling, executor=self._executor)

    @cached_property
    def places(self) -> list[Place]:
        """Row and column of each tile with a height. A few may have no triangle."""
        return sorted(self.settled.places)

    def __iter__(self) -> Iterator[TriangleMesh]:
        return (self._mesh_of([tile]) for tile in self._made())

    def __getitem__(self, place: Place) -> TriangleMesh:
        """Return the mesh of a tile; raise KeyError where it has no triangle."""
        wanted = [place] if place in self.settled.places else []
        for tile in make_tiles(self.tiling, wanted, self.settled.borders):
            return self._mesh_of([tile])
        raise KeyError(f"no tile with a triangle in row {place[0]}, column {place[1]}")

    def mesh(self) -> TriangleMesh:
        """Return all tiles as one mesh, its vertices in row-major order of their samples.

        Raises ValueError where there is no triangle at all.
        """
        tiles = list(self._made())
        if not tiles:
            raise ValueError(NO_TRIANGLE)
        return self._mesh_of(tiles)

    def _made(self) -> Iterator[Tile]:
        starts = range(0, len(self.places), _MOST_TILES)
        shares = [self.places[start : start + _MOST_TILES] for start in starts]
        borders = [self._borders_of(share) for share in shares]
        run = map if self._executor is None else self._executor.map
        for tiles in run(partial(_tiles, self.tiling), shares, borders):
            yield from tiles

    def _borders_of(self, places: Iterable[Place]) -> Borders:
        edges = {edge for place in places for edge in self.tiling.edges(place)}
        return {edge: self.settled.borders[edge] for edge in edges}

    def _mesh_of(self, tiles: list[Tile]) -> TriangleMesh:
        """Return tiles as one mesh in the array's CRS."""
        cells, width = self.tiling.cells, self.tiling.cells * self.tiling.shape[1] + 1
        nodes = np.concatenate(
            [(t.row * cells + t.rows.astype(int)) * width + t.col * cells + t.cols for t in tiles]
        )
        heights = np.concatenate([tile.heights for tile in tiles])
        nodes, first, numbers = np.unique(nodes, return_index=True, return_inverse=True)
        starts = np.cumsum([0, *(len(tile.rows) for tile in tiles)])
        corners = [t.triangles + start for t, start in zip(tiles, starts, strict=False)]
        rows, cols = np.divmod(nodes, width)
        a, b, x, d, e, y = self.tiling.lattice.transform[:6]
        places = a * cols + b * rows + x, d * cols + e * rows + y
        triangles = numbers[np.concatenate(corners)].astype(np.int32)
        if self.tiling.lattice.transform.determinant > 0.0:  # rows run north: a mirrored lattice
            triangles = triangles[:, [1, 0, 2]]
        vertices = np.column_stack([*places, heights[first]])
        return TriangleMesh(vertices, triangles, self.tiling.lattice.crs)


def _tiles(tiling: Tiling, places: list[Place], borders: Borders) -> list[Tile]:
    return list(make_tiles(tiling, places, borders))
