"""How long it takes until a raster can be looked at: first coarsely, then whole.

python benchmarks/opening.py [raster.tif …] [--side 100000] [--json]

Without rasters, one of 100 000² samples is made: sparse, flat but for its middle, no overviews.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

import rtin
from measuring import fractal_terrain, show
from rtin.viewer.opening import Opened, Opening

PATCH = 2049


def save_sparse_raster(path: Path, side: int) -> None:
    import rasterio
    from affine import Affine
    from rasterio.windows import Window

    shape = {"width": side, "height": side, "count": 1, "dtype": "float32", "BIGTIFF": "YES"}
    blocks = {"tiled": True, "blockxsize": 256, "blockysize": 256, "SPARSE_OK": True}
    place = {"crs": "EPSG:32628", "transform": Affine(1.0, 0.0, 4e5, 0.0, -1.0, 3e6)}
    with rasterio.open(path, "w", driver="GTiff", **shape, **blocks, **place) as file:
        first = (side - PATCH) // 2
        file.write(fractal_terrain(PATCH), 1, window=Window(first, first, PATCH, PATCH))


def row_of(path: Path) -> dict[str, object]:
    """Time the first stage, with its hierarchy, and reading the last one, if it is all of it."""
    begun, done, last = time.perf_counter(), threading.Event(), []

    def take(opened: Opened) -> None:
        if opened.is_final:
            last.append((opened, time.perf_counter() - begun))
            done.set()

    with Opening(path) as opening:
        first = opening.first()
        read = time.perf_counter() - begun
        rtin.LevelOfDetail(first.surface)
        ready = time.perf_counter() - begun
        opening.go_on(take, lambda _: done.set())
        if not first.is_final and first.step < 100.0:
            done.wait()
    last_step, last_read = (last[0][0].step, last[0][1]) if last else (None, None)
    rows, cols = first.surface.shape
    return {
        "raster": path.stem, "first": f"{rows} × {cols}", "read s": read, "ready s": ready,
        "last step": last_step, "last read s": last_read,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rasters", nargs="*", type=Path)
    parser.add_argument("--side", type=int, default=100_000)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    rtin.LevelOfDetail(rtin.Grid(np.eye(9)))  # compiles
    with tempfile.TemporaryDirectory() as folder:
        if not chosen.rasters:
            chosen.rasters = [Path(folder) / "sparse.tif"]
            save_sparse_raster(chosen.rasters[0], chosen.side)
        rows = [row_of(path) for path in chosen.rasters]
    show({"until a raster can be looked at": rows}, as_json=chosen.json)


if __name__ == "__main__":
    main()
