"""Terrain tiles made when they are asked for, the same bytes as ``write_tileset`` would write."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from rtin.io.quantized_mesh import QuantizedMesh
from rtin.io.tile_jobs import TileJob
from rtin.io.tileset import TileRecord
from rtin.pyramid import prepare, shares
from rtin.schemes import SCHEMES, Scheme

__all__ = ["LiveTiles"]


class LiveTiles:
    """The tiles of a terrain job, for ``rtin.serve``.

    Parameters
    ----------
    job : TileJob
        Of terrain: ``world_tiles(paths, "terrain")``.
    folder : Path
        For the heights of coarser zooms and what is kept on borders; this job's own.
    executor : concurrent.futures.Executor, optional
        Where all borders are settled, before the first tile can be made.
    tell : callable, optional
        Called with the share of that which is done.

    Raises
    ------
    OSError
        If a raster can't be read or the folder can't be written.
    """

    def __init__(
        self,
        job: TileJob,
        folder: Path,
        *,
        executor: Executor | None = None,
        tell: Callable[[float], object] | None = None,
    ) -> None:
        if not isinstance(job.output, QuantizedMesh):
            raise TypeError("tiles are served of terrain only; write others with rtin tiles")
        self._output = job.output
        levels = prepare(
            job.plan,
            folder,
            executor=executor,
            tell=None if tell is None else shares(job.plan, tell),
        )
        self._levels = {
            zoom: level.with_tiles(job.output.roots(zoom)) for zoom, level in levels.items()
        }
        index = dict(job.output.index(self._records, job.plan.tolerances))
        self.layer: dict[str, Any] = json.loads(index["layer.json"])
        self.scheme: Scheme = SCHEMES[job.output.scheme]
        self.minzoom, self.maxzoom = min(levels), max(levels)

    def terrain(self, zoom: int, x: int, y: int) -> bytes | None:
        """Return a tile by its TMS numbers, gzipped; None where there is none."""
        level = self._levels[zoom]
        for tile in level.make([((1 << zoom) - 1 - y, x)]):
            return self._output.encode(zoom, tile, level.settled.largest_range)
        return None

    def file(self, path: str) -> bytes | None:  # noqa: ARG002
        """Return None: there is nothing but terrain."""
        return None

    def health(self) -> dict[str, Any]:
        """Return how many tiles there are at each zoom."""
        return {"tiles": {zoom: len(level.available) for zoom, level in self._levels.items()}}

    def _records(self) -> Iterator[TileRecord]:
        for zoom, level in self._levels.items():
            for row, col in sorted(level.available):
                yield TileRecord(zoom, row, col, 0, 0, 0, 0.0, 0.0, 0.0, b"", b"")
