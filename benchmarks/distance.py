"""Distances beside pymeshlab's Hausdorff filter, point queries beside libigl, and the rest alone.

python benchmarks/distance.py [RASTER ...] [--crop N] [--repeats N] [--only TABLE] [--json]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import rtin
from measuring import duel, fractal_terrain, median_seconds, milliseconds, seconds, show
from rtin._sampling import samples_of
from rtin._surfaces import local_system, surface_of
from rtin.simplifiers import full_mesh

Row = dict[str, object]
SHARES = (0.002, 0.01, 0.05)  # of the height range
CELL = 30.0  # metres
MEMORY = """
import resource, sys
import numpy as np, rtin
grid = rtin.Grid(np.load(sys.argv[1]), (30.0, 0.0, 0.0, 0.0, -30.0, 0.0))
mesh = rtin.coarsen(grid, max_error=float(sys.argv[2]))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
rtin.compare(grid, mesh)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


# --- terrains -----------------------------------------------------------------------------------


def terrains(paths: list[Path], crop: int) -> Iterator[tuple[str, rtin.Grid]]:
    """Yield (name, grid), with square cells of 30 m, of each raster or of a fractal terrain."""
    for path in paths:
        heights = rtin.read_grid(path).heights
        middle = [max(0, (size - crop) // 2) for size in heights.shape]
        yield path.stem, as_grid(heights[middle[0] :, middle[1] :][:crop, :crop])
    if not paths:
        yield "fractal", as_grid(fractal_terrain(crop))


def as_grid(heights: np.ndarray) -> rtin.Grid:
    return rtin.Grid(np.ascontiguousarray(heights), (CELL, 0.0, 0.0, 0.0, -CELL, 0.0))


def coarsened(grid: rtin.Grid, share: float) -> tuple[rtin.TriangleMesh, float]:
    tolerance = share * float(np.nanmax(grid.heights) - np.nanmin(grid.heights))
    return rtin.coarsen(grid, max_error=tolerance), tolerance


def described(name: str, grid: rtin.Grid, mesh: rtin.TriangleMesh, tolerance: float) -> Row:
    rows, cols = grid.shape
    return {"raster": f"{name} {rows}×{cols}", "ε": tolerance, "vertices": mesh.n_vertices}


# --- the tables ---------------------------------------------------------------------------------


def beside_pymeshlab(name: str, grid: rtin.Grid, n_samples: int, repeats: int) -> Iterator[Row]:
    """Yield both directions of the full triangulation and coarsened meshes: as many samples."""
    import pymeshlab

    full = full_mesh(grid)
    for share in SHARES:
        mesh, tolerance = coarsened(grid, share)
        both = pymeshlab.MeshSet()
        for surface in (full, mesh):
            both.add_mesh(pymeshlab.Mesh(surface.vertices, surface.triangles))
        theirs = partial(pymeshlab_distances, both, n_samples)
        for source, kind in ((grid, "grid"), (full, "mesh")):
            ours = partial(rtin.compare, source, mesh, samples=n_samples)
            times = duel(ours, theirs, repeats)
            distance = rtin.compare(source, mesh, "montecarlo", samples=n_samples)
            their_max, their_rms = theirs()
            yield {
                **described(name, grid, mesh, tolerance),
                "full as": kind,
                "samples": distance.forward.n_samples,
                "rtin, s": min(times.ours),
                "pymeshlab, s": min(times.theirs),
                "ratio": times.ratio,
                "of best": times.ratio_of_best,
                "of cpu": times.ratio_of_work,
                "max": distance.forward.max,
                "theirs": their_max,
                "rms": distance.forward.area_rms,
                "their rms": their_rms,
            }


def pymeshlab_distances(both: Any, n_samples: int) -> tuple[float, float]:
    """Return max and rms of the first mesh from the second; both ways are measured.

    Random points of faces, which alone have the area's rms. Corners would cost it no less.
    """
    import pymeshlab

    results = [
        both.get_hausdorff_distance(
            sampledmesh=source,
            targetmesh=1 - source,
            samplevert=False,
            sampleedge=False,
            sampleface=True,
            samplenum=n_samples,
            maxdist=pymeshlab.PercentageValue(100),
        )
        for source in (0, 1)
    ]
    return results[0]["max"], results[0]["RMS"]


def queries(name: str, grid: rtin.Grid, repeats: int) -> Iterator[Row]:
    """Yield point queries a second, of all threads, of samples of a coarsened mesh and back."""
    import igl

    for share in SHARES:
        mesh, tolerance = coarsened(grid, share)
        local = local_system(grid, mesh)
        whole, coarse = surface_of(grid, local), surface_of(mesh, local)
        n_samples = 10 * whole.n_triangles
        to_grid = samples_of(coarse, "subdivision", n_samples, (0,))
        to_mesh = samples_of(whole, "subdivision", n_samples, (0,))
        few = np.concatenate([chunk.points for chunk in to_mesh.of_piece(whole.n_pieces // 2)])
        triangles = mesh.triangles.astype(np.int64)
        vertices = local.from_world(mesh.vertices)
        peer = partial(igl.point_mesh_squared_distance, few, vertices, triangles)
        yield {
            **described(name, grid, mesh, tolerance),
            "to the grid, 10⁶/s": n_samples / answering(to_grid, whole, repeats) / 1e6,
            "to the mesh, 10⁶/s": n_samples / answering(to_mesh, coarse, repeats) / 1e6,
            "libigl, 10⁶/s": len(few) / median_seconds(peer, repeats) / 1e6,
        }


def answering(samples: Any, target: Any, repeats: int) -> float:
    """Return the seconds that the queries of all samples take, in threads as ``compare`` asks."""
    from rtin import _parallel

    pieces = [
        [chunk.points for chunk in samples.of_piece(number)]
        for number in range(samples.surface.n_pieces)
    ]
    tasks = [(target, piece) for piece in pieces]
    return median_seconds(lambda: _parallel.run(ask, tasks), repeats)


def ask(target: Any, piece: list[np.ndarray]) -> None:
    for points in piece:
        target.nearest(points)


def certified(name: str, grid: rtin.Grid) -> Iterator[Row]:
    """Yield what sampling misses of the Hausdorff distance, and what bounds of it cost."""
    for share in SHARES:
        mesh, tolerance = coarsened(grid, share)
        sampled = rtin.compare(grid, mesh).hausdorff
        rtin.hausdorff(grid, mesh)
        bounds = rtin.hausdorff(grid, mesh)
        yield {
            **described(name, grid, mesh, tolerance),
            "sampled": sampled,
            "lower": bounds.lower,
            "upper": bounds.upper,
            "missed": f"{1.0 - sampled / bounds.lower:.2%}",
            "compare, s": seconds(partial(rtin.compare, grid, mesh)),
            "hausdorff, s": seconds(partial(rtin.hausdorff, grid, mesh)),
        }


def whole_rasters(paths: list[Path], repeats: int) -> Iterator[Row]:
    """Yield time and peak memory of whole rasters beside ``vertical_error``."""
    for name, grid in terrains(paths, 4097):
        mesh, tolerance = coarsened(grid, SHARES[1])
        vertical = median_seconds(partial(rtin.vertical_error, mesh, grid), repeats)
        yield {
            **described(name, grid, mesh, tolerance),
            "vertical_error, ms": milliseconds(vertical),
            "compare, s": seconds(partial(rtin.compare, grid, mesh)),
            "peak beyond inputs, MiB": peak_beyond_inputs(grid, tolerance),
        }


def peak_beyond_inputs(grid: rtin.Grid, tolerance: float) -> float:
    """Return how much memory ``compare`` takes in a process of its own (Linux)."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "heights.npy"
        np.save(path, grid.heights)
        done = subprocess.run(
            [sys.executable, "-c", MEMORY, str(path), str(tolerance)],
            capture_output=True,
            text=True,
            check=True,
        )
    return round(int(done.stdout) / 1024.0, 1)


def main() -> None:
    tables = ("pymeshlab", "queries", "certified", "whole")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rasters", nargs="*", type=Path)
    parser.add_argument("--crop", type=int, default=1025)
    parser.add_argument("--samples", type=int, default=2_500_000, help="beside pymeshlab")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", choices=tables)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    grids = list(terrains(chosen.rasters, chosen.crop))
    makers = {
        "pymeshlab": lambda name, grid: beside_pymeshlab(
            name, grid, chosen.samples, chosen.repeats
        ),
        "queries": lambda name, grid: queries(name, grid, chosen.repeats),
        "certified": certified,
    }
    made = {
        table: [row for grid in grids for row in make(*grid)]
        for table, make in makers.items()
        if chosen.only in (None, table)
    }
    if chosen.only in (None, "whole"):
        made["whole"] = list(whole_rasters(chosen.rasters, chosen.repeats))
    show(made, chosen.json)


if __name__ == "__main__":
    main()
