"""Tiles of large rasters: pixels and tiles a second, and peak memory (Linux).

python benchmarks/tiles.py [RASTER ...] [--sides 4097 8193] [--workers 2] [--folder DIR] [--json]

Each run is `rtin tiles` as a user starts it, workers and imports included. Rasters of the given
sides are written first; the rasters named are made into terrain.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rasterio
import rasterio.enums
import rasterio.vrt
import rasterio.warp
from numpy.typing import NDArray

from large_raster import write
from measuring import seconds_and_cpu, show

CELLS = 64  # of a tile of terrain
EQUATOR, CESIUM_HEIGHTS = 2.0 * math.pi * 6378137.0, 65
PEER_TILES = 1000


# --- rtin ---------------------------------------------------------------------------------------


def processes_of(pid: int) -> Iterator[int]:
    """Yield a process and all that it started."""
    yield pid
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return
    for child in children:
        yield from processes_of(int(child))


def most_memory(pid: int) -> int:
    """Return the most bytes that a process has had resident, 0 where it is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return 1024 * next((int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)


def run_tiles(arguments: list[str]) -> dict[str, float]:
    """Run ``rtin tiles``; return its summary, with processor time and the largest process."""
    command = [sys.executable, "-m", "rtin", "tiles", *arguments, "--json"]
    start, peak = time.perf_counter(), 0
    before = os.times()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        output: list[bytes] = []
        reader = threading.Thread(target=lambda: output.append(process.stdout.read()))
        reader.start()
        while reader.is_alive():
            peak = max(peak, *(most_memory(pid) for pid in processes_of(process.pid)))
            reader.join(0.05)
    wall, after = time.perf_counter() - start, os.times()
    if process.returncode:
        sys.exit(f"rtin tiles {' '.join(arguments)} failed")
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    return {**json.loads(output[0]), "wall": wall, "cpu": cpu, "peak": peak}


def glb_row(raster: Path, folder: Path, max_error: float, workers: int) -> dict[str, object]:
    with rasterio.open(raster) as dataset:
        side = dataset.width
        samples = dataset.width * dataset.height
    out = folder / "glb"
    options = ["--format", "glb", "--max-error", f"{max_error:g}", "--workers", str(workers)]
    made = run_tiles([str(raster), str(out), *options])
    shutil.rmtree(out)
    vertices = sum(level["n_vertices"] for level in made["levels"])
    return {
        "raster": f"{side}²",
        "workers": workers,
        "tiles": made["tiles"],
        "kept": f"{vertices / samples:.1%}",
        **rates(made, samples),
    }


def terrain_row(raster: Path, folder: Path, workers: int) -> tuple[dict[str, object], int]:
    """Return the figures, and the last zoom."""
    out = folder / "terrain"
    made = run_tiles([str(raster), str(out), "--workers", str(workers)])
    shutil.rmtree(out)
    nodes = made["tiles"] * CELLS**2
    row = {
        "raster": raster.stem,
        "by": "rtin, all zooms",
        "workers": workers,
        "tiles": made["tiles"],
        "tiles/s": made["tiles"] / made["wall"],
        "tiles/cpu s": made["tiles"] / made["cpu"],
        **rates(made, nodes),
    }
    return row, max(level["zoom"] for level in made["levels"])


def rates(made: dict[str, float], samples: int) -> dict[str, object]:
    return {
        "wall s": made["wall"],
        "cpu s": made["cpu"],
        "Mpx/s": samples / made["wall"] / 1e6,
        "Mpx/cpu s": samples / made["cpu"] / 1e6,
        "peak MiB": made["peak"] / 2**20,
    }


# --- pymartini and quantized-mesh-encoder ---------------------------------------------------------


def peer_tiles(raster: Path, zoom: int, count: int) -> list[tuple[int, int]]:
    """Return columns and rows (from the north) of some tiles about the raster's middle."""
    with rasterio.open(raster) as dataset:
        west, south, east, north = rasterio.warp.transform_bounds(
            dataset.crs, "EPSG:4326", *dataset.bounds
        )
    side = 180.0 / 2**zoom
    cols = range(int((west + 180.0) / side) + 1, int((east + 180.0) / side))
    rows = range(int((90.0 - north) / side) + 1, int((90.0 - south) / side))
    places = [(col, row) for row in rows for col in cols]
    return places[:: max(1, len(places) // count)][:count]


def read_nodes(warped: rasterio.vrt.WarpedVRT, bounds: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the 65 × 65 heights of a tile, bilinear, its corners on the first and last ones."""
    west, south, east, north = bounds
    half = (east - west) / CELLS / 2.0
    window = warped.window(west - half, south - half, east + half, north + half)
    shape = (CELLS + 1, CELLS + 1)
    return warped.read(1, window=window, out_shape=shape, boundless=False).astype(np.float32)


def write_peers(raster: Path, out: Path, zoom: int, places: list[tuple[int, int]]) -> None:
    """Make tiles as a script would: warp, mesh, encode, compress and write, one by one."""
    from pymartini import Martini, rescale_positions
    from quantized_mesh_encoder import encode

    martini, side = Martini(CELLS + 1), 180.0 / 2**zoom
    tolerance = 0.5 * EQUATOR * 0.25 / (CESIUM_HEIGHTS * 2 * 2**zoom)
    spacing = side / CELLS
    grid = rasterio.transform.from_origin(
        -180.0 - spacing / 2.0, 90.0 + spacing / 2.0, spacing, spacing
    )
    n_cols, n_rows = (2 << zoom) * CELLS + 1, (1 << zoom) * CELLS + 1
    with (
        rasterio.open(raster) as dataset,
        rasterio.vrt.WarpedVRT(
            dataset, crs="EPSG:4326", transform=grid, width=n_cols, height=n_rows,
            resampling=rasterio.enums.Resampling.bilinear,
        ) as warped,
    ):  # fmt: skip
        for col, row in places:
            west, north = -180.0 + col * side, 90.0 - row * side
            bounds = (west, north - side, west + side, north)
            heights = read_nodes(warped, bounds)
            vertices, triangles = martini.create_tile(heights).get_mesh(tolerance)
            positions = rescale_positions(vertices, heights, bounds=bounds, flip_y=True)
            path = out / str(zoom) / str(col) / f"{2**zoom - 1 - row}.terrain"
            path.parent.mkdir(parents=True, exist_ok=True)
            with gzip.open(path, "wb", compresslevel=4) as file:
                encode(file, positions, triangles, bounds=bounds)


def peer_row(raster: Path, folder: Path, zoom: int) -> dict[str, object] | None:
    try:
        import pymartini  # noqa: F401
        import quantized_mesh_encoder  # noqa: F401
    except ImportError as error:
        print(f"left out: {error}")
        return None
    places = peer_tiles(raster, zoom, PEER_TILES)
    out = folder / "peer"
    write_peers(raster, out, zoom, places[:10])
    wall, cpu = seconds_and_cpu(lambda: write_peers(raster, out, zoom, places))
    shutil.rmtree(out)
    made = {"wall": wall, "cpu": cpu, "peak": math.nan}
    return {
        "raster": raster.stem,
        "by": f"pymartini, zoom {zoom}",
        "workers": 1,
        "tiles": len(places),
        "tiles/s": len(places) / wall,
        "tiles/cpu s": len(places) / cpu,
        **rates(made, len(places) * CELLS**2),
    }


# --- tables -------------------------------------------------------------------------------------


def growth(options: argparse.Namespace, folder: Path) -> list[dict[str, object]]:
    rows = []
    for side in options.sides:
        raster = folder / f"{side}.tif"
        write(raster, side)
        rows += [glb_row(raster, folder, options.max_error, n) for n in options.workers]
        raster.unlink()
    return rows


def terrain(options: argparse.Namespace, folder: Path) -> list[dict[str, object]]:
    rows = []
    for raster in options.rasters:
        for workers in options.workers:
            row, zoom = terrain_row(raster, folder, workers)
            rows.append(row)
        rows.append(peer_row(raster, folder, zoom))
    return [row for row in rows if row is not None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rasters", nargs="*", type=Path, help="to be made into terrain")
    parser.add_argument("--sides", type=int, nargs="*", default=[4097, 8193])
    parser.add_argument("--max-error", type=float, default=2.0, help="of GLB tiles")
    parser.add_argument("--workers", type=int, nargs="+", default=[2])
    parser.add_argument("--folder", type=Path, help="for rasters and tiles; all are removed")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        tables = {}
        if options.sides:
            tables["GLB tiles of 1024 cells"] = growth(options, folder)
        if options.rasters:
            tables["quantized-mesh tiles of 64 cells"] = terrain(options, folder)
    if not options.json:
        processors = len(os.sched_getaffinity(0))
        print(f"{processors} processors, load {os.getloadavg()[0]:.1f}: what counts is cpu s")
        print("cesium-terrain-builder and mago-3d-terrainer are no wheels: a loop stands for them")
    show(tables, options.json)


if __name__ == "__main__":
    main()
