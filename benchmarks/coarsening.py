"""Coarsening beside pymartini and pydelatin: the same arrays, one process, taking turns.

python benchmarks/coarsening.py [RASTER ...] [--crop N] [--repeats N] [--only TABLE] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from pydelatin import Delatin
from pymartini import Martini

import rtin
from measuring import Heights, duel, fractal_terrain, median_seconds, milliseconds, seconds, show
from rtin import samples

Row = dict[str, object]
SHARES = (0.002, 0.01, 0.05)  # of the height range


# --- rasters ------------------------------------------------------------------------------------


def terrains(paths: list[Path], crop: int | None) -> Iterator[tuple[str, rtin.Grid]]:
    """Yield (name, grid) of each raster given, or of the built-in ones."""
    for path in paths:
        heights = with_border(rtin.read_grid(path).heights)
        yield path.stem, as_grid(heights[:crop, :crop])
    if not paths:
        yield "fractal", as_grid(fractal_terrain(1025)[:crop, :crop])
        yield "fractal", as_grid(fractal_terrain(4097)[:crop, :crop])
        yield "jacksboro fault", samples.jacksboro_fault()


def as_grid(heights: Heights) -> rtin.Grid:
    return rtin.Grid(np.ascontiguousarray(heights, np.float32))


def with_border(heights: Heights) -> Heights:
    """Return a 2**k tile with its last row and column doubled, as pymartini reads such tiles."""
    rows, cols = heights.shape
    if rows != cols or rows & (rows - 1):
        return heights
    return np.pad(heights, (0, 1), mode="edge")


def fits_martini(grid: rtin.Grid) -> bool:
    rows, cols = grid.shape
    return rows == cols and (rows - 1) & (rows - 2) == 0 and not grid.has_voids


def height_range(grid: rtin.Grid) -> float:
    return float(np.nanmax(grid.heights) - np.nanmin(grid.heights))


def described(name: str, grid: rtin.Grid, share: float) -> tuple[Row, float]:
    tolerance = share * height_range(grid)
    rows, cols = grid.shape
    return {"raster": f"{name} {rows}×{cols}", "ε": tolerance, "ε/range": f"{share:.1%}"}, tolerance


# --- the peers ----------------------------------------------------------------------------------


def writable(grid: rtin.Grid) -> Heights:
    """Return a copy of the heights: pymartini does not take a Grid's read-only ones."""
    return grid.heights.copy()


def martini_mesh(martini: Martini, heights: Heights, tolerance: float) -> tuple:
    return martini.create_tile(heights.ravel()).get_mesh(tolerance)


def delatin_mesh(heights: Heights, tolerance: float) -> tuple:
    tin = Delatin(heights, max_error=tolerance)
    return tin.vertices, tin.triangles


def from_martini(grid: rtin.Grid, mesh: tuple) -> rtin.TriangleMesh:
    cols, rows = np.asarray(mesh[0]).reshape(-1, 2).T.astype(np.intp)
    return on_grid(grid, rows, cols, np.asarray(mesh[1]).reshape(-1, 3))


def from_delatin(grid: rtin.Grid, mesh: tuple) -> rtin.TriangleMesh:
    cols, from_south = mesh[0][:, 0].astype(np.intp), mesh[0][:, 1].astype(np.intp)
    rows = grid.shape[0] - 1 - from_south
    assert np.array_equal(grid.heights[rows, cols], mesh[0][:, 2])
    return on_grid(grid, rows, cols, mesh[1])


def on_grid(grid: rtin.Grid, rows, cols, triangles) -> rtin.TriangleMesh:
    x, y = grid.transform * (cols, rows)
    return rtin.TriangleMesh(np.column_stack([x, y, grid.heights[rows, cols]]), triangles)


# --- the tables ---------------------------------------------------------------------------------


def threshold_beside_martini(name: str, grid: rtin.Grid, repeats: int) -> Iterator[Row]:
    """Yield times of Eq. (1) with closure: the same vertices from both."""
    if not fits_martini(grid):
        return
    set_up = seconds(lambda: Martini(grid.shape[0]))
    martini, heights = Martini(grid.shape[0]), writable(grid)
    read = min(seconds(grid.heights.sum) for _ in range(10))
    for share in SHARES:
        row, tolerance = described(name, grid, share)
        ours = rtin.coarsen(grid, threshold=tolerance)
        theirs = from_martini(grid, martini_mesh(martini, heights, tolerance))
        times = duel(
            partial(rtin.coarsen, grid, threshold=tolerance),
            partial(martini_mesh, martini, heights, tolerance),
            repeats,
        )
        yield row | {
            "vertices": ours.n_vertices,
            "same": ours.n_vertices == theirs.n_vertices,
            "rtin ms": milliseconds(np.median(times.ours)),
            "martini ms": milliseconds(np.median(times.theirs)),
            "ratio": times.ratio,
            "of best": times.ratio_of_best,
            "of cpu": times.ratio_of_work,
            "/ read once": min(times.ours) / read,
            "Martini() ms": milliseconds(set_up),
        }


def max_error_beside_peers(name: str, grid: rtin.Grid, repeats: int) -> Iterator[Row]:
    """Yield times of the least mesh within a tolerance, and of the peers' meshes for the same."""
    if grid.has_voids:
        return
    martini, heights = Martini(grid.shape[0]) if fits_martini(grid) else None, writable(grid)
    for share in SHARES:
        row, tolerance = described(name, grid, share)
        ours = partial(rtin.coarsen, grid, max_error=tolerance)
        delatin = duel(ours, partial(delatin_mesh, heights, tolerance), repeats)
        row |= {
            "vertices": ours().n_vertices,
            "rtin ms": milliseconds(np.median(delatin.ours)),
            "delatin ms": milliseconds(np.median(delatin.theirs)),
            "× delatin": delatin.ratio,
            "of best": delatin.ratio_of_best,
            "of cpu": delatin.ratio_of_work,
            "martini ms": "-",
            "× martini": "-",
            "of its cpu": "-",
        }
        if martini is not None:
            beside = duel(ours, partial(martini_mesh, martini, heights, tolerance), repeats)
            row["martini ms"] = milliseconds(np.median(beside.theirs))
            row["× martini"] = beside.ratio
            row["of its cpu"] = beside.ratio_of_work
        yield row


def vertices_at_equal_error(name: str, grid: rtin.Grid, repeats: int) -> Iterator[Row]:  # noqa: ARG001
    """Yield the peers' vertex counts, and those of the least mesh with the same true error."""
    if grid.has_voids:
        return
    martini, heights = Martini(grid.shape[0]) if fits_martini(grid) else None, writable(grid)
    for share in SHARES:
        row, tolerance = described(name, grid, share)
        meshes = {"delatin": from_delatin(grid, delatin_mesh(heights, tolerance))}
        if martini is not None:
            mesh = martini_mesh(martini, heights, tolerance)
            meshes["martini"] = from_martini(grid, mesh)
        meshes["threshold"] = rtin.coarsen(grid, threshold=tolerance)
        for peer, mesh in meshes.items():
            error = rtin.vertical_error(mesh, grid).max
            ours = rtin.coarsen(grid, max_error=error)
            assert rtin.vertical_error(ours, grid).max <= error
            yield row | {
                "peer": peer,
                "true error": error,
                "/ ε": error / tolerance,
                "peer's vertices": mesh.n_vertices,
                "rtin's vertices": ours.n_vertices,
                "ratio": mesh.n_vertices / ours.n_vertices,
            }


def other_calls(name: str, grid: rtin.Grid, repeats: int) -> Iterator[Row]:
    """Yield times of levels, budgets and measuring."""
    tolerances = [share * height_range(grid) for share in SHARES]
    row, tolerance = described(name, grid, SHARES[1])
    mesh = rtin.coarsen(grid, max_error=tolerance)
    levels = duel(
        partial(rtin.coarsen_levels, grid, tolerances),
        lambda: [rtin.coarsen(grid, max_error=tolerance) for tolerance in tolerances],
        repeats,
    )
    calls = {
        "max_error": partial(rtin.coarsen, grid, max_error=tolerance),
        "threshold": partial(rtin.coarsen, grid, threshold=tolerance),
        "max_vertices": partial(rtin.coarsen, grid, max_vertices=mesh.n_vertices),
        "max_triangles": partial(rtin.coarsen, grid, max_triangles=mesh.n_triangles),
        "vertical_error": partial(rtin.vertical_error, mesh, grid),
        "vertex_errors": partial(rtin.vertex_errors, grid),
    }
    yield (
        row
        | {"vertices": mesh.n_vertices}
        | {
            f"{call} ms": milliseconds(median_seconds(function, repeats))
            for call, function in calls.items()
        }
        | {
            "3 levels ms": milliseconds(np.median(levels.ours)),
            "3 calls ms": milliseconds(np.median(levels.theirs)),
            "ratio": levels.ratio,
        }
    )


def best_diagonals(name: str, grid: rtin.Grid, repeats: int) -> Iterator[Row]:
    """Yield what both diagonals of squares spare, beside the lattice's."""
    for share in SHARES:
        row, tolerance = described(name, grid, share)
        best, lattice = (
            partial(rtin.coarsen, grid, max_error=tolerance, diagonals=diagonals)
            for diagonals in ("best", "lattice")
        )
        times = duel(best, lattice, repeats)
        counts = [make().n_vertices for make in (lattice, best)]
        errors = [rtin.vertical_error(make(), grid) for make in (lattice, best)]
        assert errors[1].max <= tolerance
        same_count = rtin.coarsen(grid, max_vertices=counts[0], diagonals="best")
        yield row | {
            "vertices": counts[0],
            "best": counts[1],
            "fewer": f"{1 - counts[1] / counts[0]:.1%}",
            "rms": errors[0].rms,
            "best's": errors[1].rms,
            "max, as many": rtin.vertical_error(same_count, grid).max / errors[0].max,
            "ms": milliseconds(np.median(times.theirs)),
            "best ms": milliseconds(np.median(times.ours)),
            "/": 1 / times.ratio,
            "of cpu": 1 / times.ratio_of_work,
        }


TABLES = {
    "threshold": ("coarsen(threshold=ε) beside pymartini: tile and mesh", threshold_beside_martini),
    "max_error": ("coarsen(max_error=ε) beside pydelatin and pymartini", max_error_beside_peers),
    "vertices": ("vertices at the peers' true largest error", vertices_at_equal_error),
    "diagonals": ("coarsen(max_error=ε) on the lattice's diagonals and the best", best_diagonals),
    "other": ("other calls", other_calls),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rasters", nargs="*", type=Path, help="any raster that rtin reads")
    parser.add_argument("--crop", type=int, help="use the north-west N × N samples")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", choices=TABLES, action="append", help="one table or several")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    grids = list(terrains(options.rasters, options.crop))
    tables = {}
    for key in options.only or TABLES:
        title, rows_of = TABLES[key]
        tables[title] = [
            row for name, grid in grids for row in rows_of(name, grid, options.repeats)
        ]
    show(tables, options.json)


if __name__ == "__main__":
    main()
