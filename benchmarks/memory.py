"""Peak memory of coarsening beyond the raster and the mesh, as a share of the raster (Linux).

python benchmarks/memory.py [RASTER ...] [--json]

Each case runs in a process of its own.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

import rtin
from measuring import fractal_terrain, show

Result = TypeVar("Result")
SHAPES = ("1025x1025", "4097x4097", "4098x4098", "3000x5000")
CASES = {
    "max_error 5 %": ("max_error", 0.05),
    "max_error 0.2 %": ("max_error", 0.002),
    "threshold 0.2 %": ("threshold", 0.002),
    "max_vertices 1/50": ("max_vertices", 1 / 50),
    "max_triangles 1/3": ("max_triangles", 1 / 3),
}


def read(source: str) -> rtin.Grid:
    """Return the grid in a file, or fractal terrain of a shape such as 3000x5000."""
    if Path(source).exists():
        return rtin.read_grid(source)
    rows, cols = (int(n) for n in source.split("x"))
    return rtin.Grid(fractal_terrain(rows, cols))


def option(grid: rtin.Grid, case: str) -> dict[str, float]:
    """Return a case's option for a grid: shares of the height range, or of the samples."""
    name, share = CASES[case]
    if name in ("max_vertices", "max_triangles"):
        return {name: int(share * grid.heights.size)}
    return {name: share * float(np.nanmax(grid.heights) - np.nanmin(grid.heights))}


def resident(field: str) -> int:
    """Return VmRSS or VmHWM of this process in bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(field))


def peak_while(call: Callable[[], Result]) -> tuple[int, int, Result]:
    """Return resident bytes before a call, the most during it, and what it returns."""
    ctypes.CDLL(None).malloc_trim(0)  # what is freed already must not serve the call
    Path("/proc/self/clear_refs").write_text("5")  # VmHWM := VmRSS
    before = resident("VmRSS")
    result = call()
    return before, resident("VmHWM"), result


def measure(source: str, case: str) -> dict[str, object]:
    grid = read(source)
    # Compile and start threads first, on the kind of grid at hand: with voids or none, odd or not.
    small = rtin.Grid(np.ascontiguousarray(grid.heights[-257:, -257:]))
    rtin.coarsen(small, **option(small, case))
    rtin.coarsen(rtin.Grid(small.heights[:-3]), **option(small, case))
    before, peak, mesh = peak_while(lambda: rtin.coarsen(grid, **option(grid, case)))
    raster, result = grid.heights.nbytes, mesh.vertices.nbytes + mesh.triangles.nbytes
    return {
        "raster": f"{Path(source).stem} {grid.shape[0]}×{grid.shape[1]}",
        "case": case,
        "vertices": mesh.n_vertices,
        "raster MiB": raster / 2**20,
        "mesh MiB": result / 2**20,
        "beyond both MiB": (peak - before - result) / 2**20,
        "/ raster": (peak - before - result) / raster,
    }


def measure_apart(source: str, case: str) -> dict[str, object]:
    command = [sys.executable, __file__, source, "--case", case]
    return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rasters", nargs="*", default=SHAPES, help="files, or shapes like 300x500")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--case", choices=CASES, help="measure this one, in this process")
    options = parser.parse_args()
    if options.case:
        print(json.dumps(measure(options.rasters[0], options.case)))
        return
    rows = [measure_apart(source, case) for source in options.rasters for case in CASES]
    show({"peak memory beyond raster and mesh": rows}, options.json)


if __name__ == "__main__":
    main()
