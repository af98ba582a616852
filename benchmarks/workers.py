"""Tiles on 1, 2 and 4 Dask workers of this machine: seconds and efficiency.

python benchmarks/workers.py [--side 8193] [--workers 1 2 4] [--json]

Workers beyond the processors at hand only share them: with two, four workers can at best be as
quick as two. The terrain is mapped from a file, so that every worker reads it for itself.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from measuring import fractal_terrain, show
from rtin.distributed import cluster
from rtin.tiles import Tiling, checksum, make_tiles, settle_borders

CELLS, MAX_ERROR = 512, 3.0


@dataclass(frozen=True)
class FileLattice:
    """The nodes of a .npy file."""

    path: str
    rows: tuple[int, int]
    cols: tuple[int, int]
    period: None = None
    transform: Affine = Affine.identity()  # noqa: RUF009
    crs: None = None

    def read(self, rows: tuple[int, int], cols: tuple[int, int]) -> NDArray[np.float32]:
        window = np.full((rows[1] - rows[0], cols[1] - cols[0]), np.nan, np.float32)
        row, end_row = max(rows[0], 0), min(rows[1], self.rows[1])
        col, end_col = max(cols[0], 0), min(cols[1], self.cols[1])
        inside = window[row - rows[0] :, col - cols[0] :][: end_row - row, : end_col - col]
        heights = np.load(self.path, mmap_mode="r")
        inside[...] = heights[row:end_row, col:end_col]
        return window


def made(tiling: Tiling, borders: dict, places: list[tuple[int, int]]) -> int:
    """Return the checksum of some tiles."""
    total = 0
    for tile in make_tiles(tiling, places, borders):
        rows, cols = tile.rows + tile.row * CELLS, tile.cols + tile.col * CELLS
        total += checksum(rows, cols, tile.heights, tile.triangles)
    return total % 2**64


def run(tiling: Tiling, executor: Executor) -> int:
    borders = settle_borders(tiling, executor=executor).borders
    rows: dict[int, list[tuple[int, int]]] = {}
    for place in tiling.tiles():
        rows.setdefault(place[0], []).append(place)
    edges = [{e for place in row for e in tiling.edges(place)} for row in rows.values()]
    known = [{edge: borders[edge] for edge in row} for row in edges]
    return sum(executor.map(partial(made, tiling), known, rows.values())) % 2**64


def measured(path: str, side: int, n_workers: int) -> tuple[float, int]:
    """Return seconds of the second run, and the checksum: the first loads the kernels."""
    with cluster(workers=n_workers) as executor:
        lattice = FileLattice(path, (0, side), (0, side))
        tiling = Tiling.of_raster(lattice, CELLS, MAX_ERROR)
        run(tiling, executor)
        start = time.perf_counter()
        total = run(tiling, executor)
        return time.perf_counter() - start, total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=8193)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    processors = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "terrain.npy")
        np.save(path, fractal_terrain(options.side))
        results = {n: measured(path, options.side, n) for n in options.workers}
    if len({total for _, total in results.values()}) > 1:
        sys.exit("the checksums differ")
    one = results[options.workers[0]][0] * options.workers[0]
    rows = [
        {
            "workers": n,
            "seconds": round(seconds, 2),
            "Mpx/s": round(options.side**2 / seconds / 1e6, 1),
            "efficiency": round(one / seconds / n, 2),
            "of the processors": round(one / seconds / min(n, processors), 2),
        }
        for n, (seconds, _) in results.items()
    ]
    print(f"this machine has {processors} processors, and others may be using them")
    show({f"{options.side}², tiles of {CELLS} cells, same checksum": rows}, options.json)


if __name__ == "__main__":
    main()
