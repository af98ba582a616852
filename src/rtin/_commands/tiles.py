"""The commands ``rtin tiles`` and ``rtin serve``."""

from __future__ import annotations

import math
import os
import time
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rtin._commands._console import (
    Json,
    announce,
    one_line_errors,
    progress,
    progress_bar,
    report,
    say,
    say_if_not_compiled,
)
from rtin._commands._surfaces import Band, Encoding

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Executor

    from rtin.io.tile_jobs import TileJob
    from rtin.io.tileset import Summary

__all__ = ["serve", "tiles"]

_FEW_TILES = 1000  # are made sooner than other processes are started
_GDALS_MEGABYTES = "256"  # of blocks kept, where tiles are made: a twentieth of the memory is usual

_Zoom = Annotated[
    str | None,
    typer.Option(metavar="FIRST-LAST", help="Zooms to make; as fine as the rasters are."),
]
_MaxErrors = Annotated[
    str | None,
    typer.Option(
        "--max-error",
        metavar="HEIGHTS",
        help="Tolerance at the last zoom, doubled for each coarser one; or one for each, by "
        "commas, from the first on. By default half of what CesiumJS takes a zoom to have.",
    ),
]
_Scheme = Annotated[
    Literal["geographic", "mercator"],
    typer.Option(help="How the globe is cut: EPSG:4326 or EPSG:3857."),
]
_Cells = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Cells along a side of a tile, a power of two: 64 on a globe, 1024 for meshes.",
        show_default=False,
    ),
]
_Fill = Annotated[
    str | None,
    typer.Option(
        metavar="HEIGHT",
        help="Height of voids in tiles with heights, or none: 0 for terrain, none for others.",
        show_default=False,
    ),
]
_Geoid = Annotated[
    Literal["egm2008", "egm96"] | None,
    typer.Option(help="Heights are above it: turn them into heights above the ellipsoid."),
]
_NoNormals = Annotated[
    bool, typer.Option("--no-normals", help="Terrain without normals for light and shade.")
]
_Attribution = Annotated[
    str | None, typer.Option(metavar="TEXT", help="Whom viewers are to credit.")
]
_Workers = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Processes; as many as processors.", show_default=False),
]


def tiles(
    paths: Annotated[
        list[Path], typer.Argument(metavar="DEM... OUT", help="Rasters, and the folder to fill.")
    ],
    kind: Annotated[
        Literal["terrain", "3dtiles", "glb", "obj", "ply", "stl"],
        typer.Option(
            "--format",
            help="Quantized-mesh terrain or 3D Tiles for a globe, or a mesh file for each tile.",
        ),
    ] = "terrain",
    zoom: _Zoom = None,
    max_error: _MaxErrors = None,
    scheme: _Scheme = "geographic",
    cells: _Cells = None,
    fill: _Fill = None,
    geoid: _Geoid = None,
    no_normals: _NoNormals = False,
    attribution: _Attribution = None,
    local: Annotated[
        bool,
        typer.Option("--local", help="Mesh files count x and y from the raster's middle."),
    ] = False,
    update: Annotated[
        bool, typer.Option("--update", help="Make anew what a changed raster touches.")
    ] = False,
    workers: _Workers = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Dask cluster to work, such as tcp://10.0.0.1:8786; it must see the same files.",
        ),
    ] = None,
    band: Band = 1,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Cut rasters into tiles without cracks, at every zoom; goes on where it was ended.

    Memory holds a few tiles at a time, however large the rasters are.
    """
    if len(paths) < 2:
        raise typer.BadParameter("at least one raster and the folder to fill are wanted")
    _require_options_of(kind, local=local, fill=fill, geoid=geoid, attribution=attribution)
    if scheduler is not None:
        if workers is not None:
            raise typer.BadParameter("give --workers or --scheduler, not both")
        paths = [path.absolute() for path in paths]  # its workers are in folders of their own
    *dems, out = paths
    job_of = partial(
        _tile_job, dems, kind, zoom=_zooms_of(zoom),
        max_error=_numbers_of("--max-error", max_error), cells=cells, band=band, encoding=encoding,
        local=local,
        world={"scheme": scheme, "fill": fill, "geoid": geoid, "normals": not no_normals,
               "attribution": attribution},
    )  # fmt: skip
    with one_line_errors():
        started = time.perf_counter()
        job = _announced(job_of, dems)
        with (
            _workers(job, workers, scheduler) as executor,
            progress_bar(f"making {out}") as tell,
        ):
            made = job.write(out, update=update, executor=executor, tell=tell)
        seconds = time.perf_counter() - started
        _report_tiles(job, dems, out, made, seconds, as_json)


def _announced(job_of: Callable[[], TileJob], dems: list[Path]) -> TileJob:
    """Return a job, after saying all that is to be known before it begins."""
    os.environ.setdefault("GDAL_CACHEMAX", _GDALS_MEGABYTES)  # for worker processes, too
    with progress(f"looking at {_listed(dems)}"):
        job = job_of()
    for note in job.notes:
        say(note)
    say_if_not_compiled()
    return job


def _workers(
    job: TileJob, number: int | None, scheduler: str | None = None
) -> AbstractContextManager[Executor | None]:
    """Return what gives an executor: of a Dask cluster, or of processes here."""
    if scheduler is not None:
        from rtin.distributed import cluster

        return cluster(scheduler)
    from rtin import _parallel

    if number is None:
        number = 1 if job.plan.n_tiles <= _FEW_TILES else _parallel.thread_count()
    return _parallel.processes(number)


def _tile_job(
    dems: list[Path],
    kind: str,
    *,
    zoom: tuple[int | None, int | None],
    max_error: list[float],
    cells: int | None,
    band: int,
    encoding: str | None,
    world: dict[str, Any],
    local: bool = False,
) -> TileJob:
    """Return the job that the options ask for."""
    from rtin.io.tile_jobs import raster_tiles, world_tiles

    common: dict[str, Any] = {"zoom": zoom, "max_error": max_error, "band": band}
    common |= {"encoding": encoding} | ({} if cells is None else {"cells": cells})
    if kind in ("terrain", "3dtiles"):
        fill, credit = world.pop("fill"), world.pop("attribution")
        if fill is not None:
            common["fill"] = None if fill == "none" else _numbers_of("--fill", fill)[0]
        about = {"name": _listed(dems), "attribution": credit or ""}
        return world_tiles(dems, kind, about=about, **world, **common)  # type: ignore[arg-type]
    if len(dems) > 1:
        raise ValueError(f"--format {kind} takes one raster, got {len(dems)}; make a VRT of them")
    return raster_tiles(dems[0], kind, local=local, **common)


def _require_options_of(kind: str, *, local: bool, **of_globe: str | None) -> None:
    """Refuse options that the format would pass over."""
    given = [name for name, value in of_globe.items() if value is not None]
    if kind in ("terrain", "3dtiles") and local:
        raise typer.BadParameter("--local goes with --format glb, obj, ply or stl")
    if kind not in ("terrain", "3dtiles") and given:
        raise typer.BadParameter(f"--{given[0]} goes with --format terrain or 3dtiles")


def _zooms_of(text: str | None) -> tuple[int | None, int | None]:
    """Return first and last zoom: of "3-7", "7", or nothing."""
    if text is None:
        return None, None
    first, _, last = text.partition("-")
    if not (first.isdigit() and (last.isdigit() or "-" not in text)):
        raise typer.BadParameter(f"--zoom wants one zoom or two, such as 0-12, got {text!r}")
    return int(first), int(last or first)


def _numbers_of(option: str, text: str | None) -> list[float]:
    """Return the numbers between commas."""
    try:
        numbers = [float(part) for part in (text or "").split(",") if text is not None]
    except ValueError:
        numbers = [math.nan]
    if any(not math.isfinite(number) for number in numbers):
        raise typer.BadParameter(f"{option} wants numbers, got {text!r}")
    return numbers


def _listed(paths: list[Path]) -> str:
    more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    return f"{paths[0].name}{more}"


def _report_tiles(
    job: TileJob, dems: list[Path], out: Path, made: Summary, seconds: float, as_json: bool
) -> None:
    n_nodes = sum(level.n_tiles for level in made.levels) * job.plan.cells**2
    summary: dict[str, Any] = {
        "input": [str(dem) for dem in dems],
        "output": str(out),
        "tiles": sum(level.n_tiles for level in made.levels),
        "made": made.n_made,
        "removed": made.n_removed,
        "bytes": sum(level.n_bytes for level in made.levels),
        "seconds": round(seconds, 3),
    }
    if as_json:
        levels = [asdict(level) for level in made.levels]
        report({**summary, "nodes": n_nodes, "levels": levels, "notes": job.notes}, as_json)
        return
    print(f"{'zoom':>6}{'tiles':>9}{'vertices':>12}{'triangles':>12}{'tolerance':>12}{'error':>12}")
    for level in made.levels:
        counts = f"{level.n_tiles:>9}{level.n_vertices:>12}{level.n_triangles:>12}"
        print(f"{level.zoom:>6}{counts}{level.tolerance:>12.6g}{level.max_error:>12.6g}")
    report({**summary, "notes": job.notes}, as_json)


def serve(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="TILES|DEM...", help="A folder that rtin tiles has filled, or rasters."
        ),
    ],
    host: Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0: all.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any that is free.")] = 8080,
    cesium: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Where npm has installed CesiumJS, if not here."),
    ] = None,
    zoom: _Zoom = None,
    max_error: _MaxErrors = None,
    scheme: _Scheme = "geographic",
    cells: _Cells = None,
    fill: _Fill = None,
    geoid: _Geoid = None,
    no_normals: _NoNormals = False,
    attribution: _Attribution = None,
    workers: _Workers = None,
    band: Band = 1,
    encoding: Encoding = None,
) -> None:
    """Serve terrain tiles over HTTP, with pages that show them.

    The tiles of rasters are made when they are asked for, and are those that rtin tiles would
    write. Options from --zoom on are for rasters.
    """
    with one_line_errors(), ExitStack() as stack:
        from rtin import serve as server

        if len(paths) == 1 and paths[0].is_dir():
            server.run(server.FolderStore(paths[0]), host, port, cesium=cesium, say=announce)
            return
        from rtin.io.live_tiles import LiveTiles

        job_of = partial(
            _tile_job, paths, "terrain", zoom=_zooms_of(zoom),
            max_error=_numbers_of("--max-error", max_error),
            cells=cells, band=band, encoding=encoding,
            world={"scheme": scheme, "fill": fill, "geoid": geoid, "normals": not no_normals,
                   "attribution": attribution},
        )  # fmt: skip
        job = _announced(job_of, paths)
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="rtin-serve-")))
        with (
            _workers(job, workers) as executor,
            progress_bar(f"preparing {_listed(paths)}") as tell,
        ):
            live = LiveTiles(job, folder, executor=executor, tell=tell)
        server.run(live, host, port, cesium=cesium, say=announce)
