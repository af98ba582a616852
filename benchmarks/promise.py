"""Check the promise of ``max_error`` on rasters of your own, with an evaluator of its own.

    python benchmarks/promise.py dem.tif other.tif ...

For each raster and each of three tolerances, every valid sample is compared with the mesh in
float64: with the mesh as returned, and with it as read back from files, where the rounding of the
file's numbers is added. Nothing of rtin's own error measurement is used: triangles are grouped by
shape, and each group's samples are weighed by barycentric coordinates.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

import rtin

FRACTIONS_OF_RANGE = (0.05, 0.01, 0.002)
FORMATS = (".glb", ".ply", ".obj")
CHUNK = 1 << 22


def largest_error(mesh, grid):
    """Return the largest abs(surface - sample) and how many valid samples have no surface."""
    a, b, x0, d, e, y0 = tuple(grid.transform)[:6]
    inverse = np.linalg.inv(np.array([[a, b], [d, e]]))
    places = (mesh.vertices[:, :2] - (x0, y0)) @ inverse.T
    cols, rows = np.rint(places).astype(np.int64).T
    rows, cols = rows[mesh.triangles], cols[mesh.triangles]
    z = mesh.vertices[:, 2][mesh.triangles]
    covered = np.isnan(grid.heights)
    largest = 0.0
    for shape, members in shapes(rows, cols):
        step = max(1, CHUNK // len(shape[0]))
        for start in range(0, len(members), step):
            part = members[start : start + step]
            at = rows[part, :1] + shape[0], cols[part, :1] + shape[1]
            surface = z[part] @ shape[2]
            largest = max(largest, float(np.abs(surface - grid.heights[at]).max()))
            covered[at] = True
    return largest, int(np.count_nonzero(~covered))


def shapes(rows, cols):
    """Yield (row offsets, column offsets, weights (3, n)) and members of each shape of triangle."""
    offsets = np.column_stack([rows[:, 1:] - rows[:, :1], cols[:, 1:] - cols[:, :1]])
    distinct, group = np.unique(offsets, axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    members = np.split(order, np.cumsum(np.bincount(group.ravel()))[:-1])
    for (r1, r2, c1, c2), triangles in zip(distinct, members, strict=True):
        r, c = np.mgrid[min(0, r1, r2) : max(0, r1, r2) + 1, min(0, c1, c2) : max(0, c1, c2) + 1]
        r, c = r.ravel(), c.ravel()
        area = r1 * c2 - r2 * c1
        second, third = (r * c2 - c * r2) / area, (r1 * c - c1 * r) / area
        weights = np.array([1.0 - second - third, second, third])
        inside = (weights >= 0.0).all(axis=0)
        yield (r[inside], c[inside], weights[:, inside]), triangles


def check(path, folder):
    """Print the largest error of each tolerance and format; return whether all keep the promise."""
    grid = rtin.read_grid(path)
    low, high = float(np.nanmin(grid.heights)), float(np.nanmax(grid.heights))
    kept = True
    for fraction in FRACTIONS_OF_RANGE:
        asked = fraction * (high - low)
        mesh = rtin.coarsen(grid, max_error=asked)
        error, uncovered = largest_error(mesh, grid)
        reported = rtin.vertical_error(mesh, grid)
        # An evaluation that adds weighted heights rounds where the mesh itself does not.
        rounding = 8 * np.spacing(max(abs(low), abs(high)))
        kept &= error <= asked + rounding and uncovered == reported.n_uncovered
        line = f"{Path(path).name:28s} {asked:10.4f} {error:10.4f} {mesh.n_vertices:9d}"
        for suffix in FORMATS:
            file = Path(folder) / f"mesh{suffix}"
            rtin.write_mesh(mesh, file)
            from_file, _ = largest_error(rtin.read_mesh(file), grid)
            kept &= from_file <= asked + np.spacing(np.float32(max(abs(low), abs(high)))) + 1e-6
            line += f" {from_file - error:10.1e}"
        print(line, flush=True)
    return kept


def main():
    """Check all rasters named on the command line, or the sample ones."""
    header = f"{'raster':28s} {'asked':>10s} {'achieved':>10s} {'vertices':>9s}"
    print(header + "".join(f" {suffix:>10s}" for suffix in FORMATS))
    with tempfile.TemporaryDirectory() as folder:
        paths = sys.argv[1:]
        if not paths:
            paths = [Path(folder) / "jacksboro.npy"]
            np.save(paths[0], rtin.samples.jacksboro_fault().heights)
        kept = [check(path, folder) for path in paths]
        if not all(kept):
            sys.exit("the promise is broken")
    print("the promise holds")


if __name__ == "__main__":
    main()
