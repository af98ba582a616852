"""Level of detail: milliseconds a view along a flight, preparing, updating; beside pymartini.

python benchmarks/level_of_detail.py [RASTER ...] [--triangles N] [--only TABLE] [--json]

The flight is recorded in flight.json: 300 views, low over the ground with turns, then a climb, from
where all is seen. Without rasters a fractal terrain of 4097² samples is flown over.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import rtin
from measuring import fractal_terrain, milliseconds, seconds, show
from rtin.lod import GROWTH

FIELD_OF_VIEW, HEIGHT, ASPECT = 60.0, 1080, 16.0 / 9.0
PIXELS = HEIGHT / (2.0 * math.tan(math.radians(FIELD_OF_VIEW) / 2.0))  # of 1 m in 1 m
COMPARED = 8  # views beside pymartini and the least mesh
LADDER = [0.25 * 2.0**step for step in range(12)]  # pymartini's tolerances, in metres
Floats = NDArray[np.float64]
Rows = list[dict[str, object]]


class Seen(NamedTuple):
    """One view: an eye, and the planes around what it sees, if not all round."""

    eye: Floats
    planes: Floats | None


class Scene(NamedTuple):
    """A terrain in metres, its hierarchy, and the flight over it."""

    name: str
    grid: rtin.Grid
    lod: rtin.LevelOfDetail
    flight: list[Seen]


def flight_over(grid: rtin.Grid) -> list[Seen]:
    rows, cols = grid.shape
    a, _, x0, _, e, y0 = tuple(grid.transform)[:6]
    west, south, side = x0, y0 + e * (rows - 1), max(a * (cols - 1), -e * (rows - 1))
    recorded = json.loads(Path(__file__).with_name("flight.json").read_text())["views"]
    points = np.array(recorded).reshape(-1, 3) * side + (west, south, 0.0)
    ground = grid.heights_at(points[:, :2])
    points[:, 2] += np.where(np.isnan(ground), np.nanmin(grid.heights), ground)
    return [
        Seen(eye, rtin.frustum(eye, target, field_of_view=FIELD_OF_VIEW, aspect=ASPECT))
        for eye, target in points.reshape(-1, 2, 3)
    ]


def scene_of(name: str, grid: rtin.Grid) -> Scene:
    grid = grid.in_metres()
    return Scene(name, grid, rtin.LevelOfDetail(grid), flight_over(grid))


# --- rtin ---------------------------------------------------------------------------------------


def views(scene: Scene, n_triangles: int) -> Rows:
    """Time every view of the flight in each way, after a few to warm up."""
    lod = scene.lod
    around = [seen._replace(planes=None) for seen in scene.flight]
    kept, kept_around = (_kept(lod, flight, n_triangles) for flight in (scene.flight, around))
    ways: dict[str, tuple[float, Callable[[int, Seen], rtin.TriangleMesh]]] = {
        "frame, budget, frustum": (median(kept), lambda _, seen: (
            lod.frame(seen.eye, max_triangles=n_triangles, frustum=seen.planes).mesh
        )),
        "mesh, budget, frustum": (median(kept) / GROWTH**2, lambda _, seen: lod.mesh(
            seen.eye, max_triangles=n_triangles, frustum=seen.planes
        )),
        "mesh, budget, all round": (median(kept_around) / GROWTH**2, lambda _, seen: lod.mesh(
            seen.eye, max_triangles=n_triangles
        )),
        "frame, pixel error, frustum": (median(kept), lambda i, seen: (
            lod.frame(seen.eye, pixel_error=kept[i], frustum=seen.planes).mesh
        )),
    }  # fmt: skip
    return [
        {"raster": scene.name, "what": way, **_figures(scene.flight, cut),
         "pixel error": round(tolerance, 2)}
        for way, (tolerance, cut) in ways.items()
    ]  # fmt: skip


def _kept(lod: rtin.LevelOfDetail, flight: list[Seen], n_triangles: int) -> list[float]:
    """Return the pixel errors of frames within a budget."""
    return [
        lod.frame(seen.eye, max_triangles=n_triangles, frustum=seen.planes).pixel_error
        for seen in flight
    ]


def _figures(flight: list[Seen], cut: Callable[[int, Seen], rtin.TriangleMesh]) -> dict[str, float]:
    """Wall clock and processor time of a call for each view; one thread does all of it."""
    walls, cpus, sizes = [], [], []
    for i, seen in enumerate(flight):
        began, cpu = time.perf_counter(), time.thread_time()
        mesh = cut(i, seen)
        walls.append(time.perf_counter() - began)
        cpus.append(time.thread_time() - cpu)
        sizes.append(mesh.n_triangles)
    figures = {"triangles": int(median(sizes))}
    for name, times in {"ms": walls, "ms of cpu": cpus}.items():
        figures |= {name: milliseconds(median(times))}
        figures |= {f"{name}, 99 %": milliseconds(float(np.percentile(times, 99)))}
    return figures


def preparing(scene: Scene) -> Rows:
    """Time the hierarchy, and updates of 64 × 64 samples at random places."""
    grid = scene.grid
    times = [seconds(lambda: rtin.LevelOfDetail(grid)) for _ in range(3)]
    lod, rng, updates = rtin.LevelOfDetail(grid), np.random.default_rng(1), []
    for _ in range(100):
        row, col = (int(rng.integers(0, length - 64)) for length in grid.shape)
        patch = np.s_[row : row + 64, col : col + 64]
        heights = grid.heights[patch] + rng.normal(0.0, 20.0, (64, 64)).astype(np.float32)
        updates.append(seconds(lambda patch=patch, heights=heights: lod.update(*patch, heights)))
    return [{
        "raster": scene.name, "ns a sample": 1e9 * median(times) / grid.heights.size,
        "hierarchy / raster": lod.nbytes / grid.heights.nbytes,
        "update ms": milliseconds(median(updates[1:])),
        "99 %": milliseconds(np.percentile(updates[1:], 99)),
    }]  # fmt: skip


def growth(scene: Scene, n_triangles: int) -> Rows:
    """Time views of more and more triangles; and as many, cut from smaller and larger rasters."""
    rows: Rows = []
    for number in (1000, 10_000, 100_000, 1_000_000):
        rows.append(_timed(scene.name, scene.lod, scene.flight[::10], number))
    for side in (1025, 2049, 4097, 8193):
        grid = rtin.Grid(fractal_terrain(side), (10.0, 0.0, 0.0, 0.0, -10.0, 0.0))
        lod = rtin.LevelOfDetail(grid)
        rows.append(_timed(f"fractal {side}²", lod, flight_over(grid)[::10], n_triangles))
    return rows


def _timed(
    name: str, lod: rtin.LevelOfDetail, flight: list[Seen], n_triangles: int
) -> dict[str, object]:
    sizes: list[int] = []
    times = [
        seconds(
            lambda seen=seen: sizes.append(
                lod.mesh(seen.eye, max_triangles=n_triangles, frustum=seen.planes).n_triangles
            )
        )
        for seen in [flight[0], *flight]
    ]
    ms = median(times[1:])
    size = int(median(sizes[1:]))
    return {"raster": name, "triangles": size, "ms": milliseconds(ms), "ns each": 1e9 * ms / size}


# --- others --------------------------------------------------------------------------------------


def worst_pixels(grid: rtin.Grid, field: Floats, seen: Seen) -> float:
    """The largest error in pixels over all samples inside the frustum: from the field alone."""
    rows, cols = grid.shape
    a, _, x0, _, e, y0 = tuple(grid.transform)[:6]
    x, y = x0 + a * np.arange(cols), y0 + e * np.arange(rows)
    worst = 0.0
    for first in range(0, rows, 512):
        band = slice(first, first + 512)
        z, errors = grid.heights[band].astype(np.float64), np.abs(field[band])
        inside = np.isfinite(errors)
        for p, q, r, s in () if seen.planes is None else seen.planes:
            inside &= p * x + (q * y[band])[:, None] + r * z + s >= 0.0
        down, across, up = y[band][:, None] - seen.eye[1], x - seen.eye[0], z - seen.eye[2]
        distance = np.sqrt(down * down + across * across + up * up)
        worst = max(worst, float(np.max(PIXELS * errors / distance, where=inside, initial=0.0)))
    return worst


def beside_pymartini(scene: Scene, n_triangles: int) -> Rows:
    """Per view: pymartini's mesh as good as ours, and one of as many triangles."""
    from pymartini import Martini

    grid, lod = scene.grid, scene.lod
    martini = Martini(grid.shape[0])
    tile = martini.create_tile(np.ascontiguousarray(grid.heights))
    chosen = scene.flight[:: len(scene.flight) // COMPARED][:COMPARED]
    ours = [lod.mesh(seen.eye, max_triangles=n_triangles, frustum=seen.planes) for seen in chosen]
    our_pixels = [
        worst_pixels(grid, rtin.vertical_error(mesh, grid).field, seen)
        for mesh, seen in zip(ours, chosen, strict=True)
    ]
    pixels, sizes = np.empty((len(LADDER), len(chosen))), []
    for step, tolerance in enumerate(LADDER):
        field = rtin.vertical_error(_martini_mesh(tile, tolerance, grid), grid).field
        pixels[step] = [worst_pixels(grid, field, seen) for seen in chosen]
        sizes.append(len(tile.get_mesh(tolerance)[1]) // 3)
    rows: Rows = []
    for number, seen in enumerate(chosen):
        as_good = np.flatnonzero(pixels[:, number] <= our_pixels[number])
        step = int(as_good.max()) if as_good.size else 0
        as_many = int(np.argmin(np.abs(np.log(np.array(sizes) / ours[number].n_triangles))))

        def cut(seen: Seen = seen) -> object:
            return lod.mesh(seen.eye, max_triangles=n_triangles, frustum=seen.planes)

        cut()
        mine = median(seconds(cut) for _ in range(5))
        theirs = median(seconds(lambda step=step: tile.get_mesh(LADDER[step])) for _ in range(3))
        equal = median(seconds(lambda step=as_many: tile.get_mesh(LADDER[step])) for _ in range(3))
        rows.append({
            "raster": scene.name, "view": number * (len(scene.flight) // COMPARED),
            "triangles": ours[number].n_triangles, "pixels": our_pixels[number],
            "ms": milliseconds(mine),
            "martini as good": sizes[step], "its pixels": pixels[step, number],
            "its ms": milliseconds(theirs), "ratio": theirs / mine,
            "martini as many": sizes[as_many], "these pixels": pixels[as_many, number],
            "these ms": milliseconds(equal),
        })  # fmt: skip
    return rows


def _martini_mesh(tile: object, tolerance: float, grid: rtin.Grid) -> rtin.TriangleMesh:
    places, triangles = tile.get_mesh(tolerance)  # type: ignore[attr-defined]
    col, row = places.reshape(-1, 2).T.astype(np.int64)
    a, b, x0, d, e, y0 = tuple(grid.transform)[:6]
    heights = grid.heights[row, col].astype(np.float64)
    vertices = np.column_stack([a * col + b * row + x0, d * col + e * row + y0, heights])
    return rtin.TriangleMesh(vertices, triangles.reshape(-1, 3).astype(np.int32))


def beside_the_least(scene: Scene, n_triangles: int) -> Rows:
    """Vertices of the least mesh that keeps the same pixel error all round."""
    rows: Rows = []
    rows_, cols_ = scene.grid.shape
    a, _, x0, _, e, y0 = tuple(scene.grid.transform)[:6]
    x, y = x0 + a * np.arange(cols_), y0 + e * np.arange(rows_)
    for number in range(0, len(scene.flight), len(scene.flight) // 5):
        eye = scene.flight[number].eye
        frame = scene.lod.frame(eye, max_triangles=n_triangles)
        mesh = scene.lod.mesh(eye, pixel_error=frame.pixel_error)
        distance = np.sqrt(
            ((y - eye[1]) ** 2)[:, None] + (x - eye[0]) ** 2 + (scene.grid.heights - eye[2]) ** 2
        )
        least = rtin.coarsen(scene.grid, max_error=frame.pixel_error * distance / PIXELS)
        rows.append({
            "raster": scene.name, "view": number, "pixel error": frame.pixel_error,
            "least": least.n_vertices, "mesh / least": mesh.n_vertices / least.n_vertices,
            "frame / least": frame.mesh.n_vertices / least.n_vertices,
        })  # fmt: skip
    return rows


TABLES = {
    "views": views,
    "preparing": lambda scene, _: preparing(scene),
    "growth": growth,
    "pymartini": beside_pymartini,
    "least": beside_the_least,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("rasters", nargs="*", metavar="RASTER")
    parser.add_argument("--triangles", type=int, default=100_000, metavar="N")
    parser.add_argument("--only", choices=TABLES)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    grids = {Path(path).stem: rtin.read_grid(path) for path in chosen.rasters} or {
        "fractal 4097²": rtin.Grid(fractal_terrain(4097), (10.0, 0.0, 0.0, 0.0, -10.0, 0.0))
    }
    made: dict[str, Rows] = {}
    for name, grid in grids.items():
        scene = scene_of(name, grid)
        for table, measure in TABLES.items():
            if chosen.only in (None, table):
                made.setdefault(table, []).extend(measure(scene, chosen.triangles))
    show(made, chosen.json)


if __name__ == "__main__":
    main()
