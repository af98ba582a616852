"""The command ``rtin refine``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rtin._commands._console import Json, one_line_errors, progress, report
from rtin._commands._surfaces import (
    Band,
    Encoding,
    KeepDegrees,
    MeshOut,
    Window,
    ZScale,
    achieved_figures,
    measured_error,
    mesh_counts,
    name_of,
    read_raster,
)
from rtin._commands._usage import (
    flag_of,
    require_mesh_out,
    require_positive,
    the_only_option,
    values_are_usage,
)

if TYPE_CHECKING:
    from rtin.grid import Grid
    from rtin.mesh import TriangleMesh

__all__ = ["refine"]


def refine(
    path: Annotated[Path, typer.Argument(metavar="MESH", help="A mesh that rtin reads.")],
    out: MeshOut,
    where: Annotated[
        str | None,
        typer.Option(
            metavar="CONDITION",
            help="Refine triangles that meet it, such as 'z > 100 and slope < 30'; of x, y, z, "
            "z_min, z_max, area, length (of the longest edge), slope (degrees), tag, number.",
        ),
    ] = None,
    triangles: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Refine those that a file lists: text, or .npy."),
    ] = None,
    uniform: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Refine all triangles, N times.")
    ] = None,
    max_error: Annotated[
        float | None,
        typer.Option(
            metavar="HEIGHT", help="Refine until every sample of --dem is within this, vertically."
        ),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(metavar="HEIGHT", help="Refine while Eq. (1) of the paper exceeds this."),
    ] = None,
    dem: Annotated[
        Path | None,
        typer.Option(metavar="DEM", help="Raster that gives new vertices their heights."),
    ] = None,
    scheme: Annotated[
        Literal["4T-LE", "4T-SS", "bisection"] | None,
        typer.Option(
            help="How a triangle is split: 4T-LE, but bisection to fit a raster, by default.",
            show_default=False,
        ),
    ] = None,
    times: Annotated[
        int, typer.Option(metavar="N", min=1, help="Ask --where so often, each time anew.")
    ] = 1,
    band: Band = 1,
    window: Window = None,
    encoding: Encoding = None,
    z_scale: ZScale = 1.0,
    keep_degrees: KeepDegrees = False,
    as_json: Json = False,
) -> None:
    """Refine a triangle mesh, locally or as a whole, and keep it conforming."""
    asked = the_only_option(
        where=where,
        triangles=triangles,
        uniform=uniform,
        max_error=max_error,
        threshold=threshold,
    )
    is_fit = bool({"max_error", "threshold"} & asked.keys())
    if dem is None and is_fit:
        raise typer.BadParameter(f"{flag_of(next(iter(asked)))} wants a raster to fit: --dem DEM")
    scheme = scheme or ("bisection" if is_fit else "4T-LE")
    if times > 1 and where is None:
        raise typer.BadParameter("--times goes with --where; for all triangles there is --uniform")
    require_positive("--z-scale", z_scale)
    with one_line_errors():
        from rtin.io.meshes import placement_of, read_mesh, write_mesh

        require_mesh_out(out, dem)
        started = time.perf_counter()
        with progress(f"reading {path}"):
            mesh = read_mesh(path)
        grid = None if dem is None else read_raster(dem, band, window, encoding)
        _require_same_crs(mesh, grid)
        with progress(f"refining {mesh.n_triangles} triangles"):
            refined = _refined_or_refused(mesh, grid, asked, scheme, times)
        achieved = {} if grid is None else _achieved_by(refined, grid)
        with progress(f"writing {out}"):
            write_mesh(refined, out, z_scale=z_scale, keep_degrees=keep_degrees)
        summary = {
            "input": str(path),
            "output": str(out),
            "before": mesh_counts(mesh),
            **mesh_counts(refined),
            "asked": {name: str(v) if isinstance(v, Path) else v for name, v in asked.items()},
            "scheme": scheme,
            **achieved,
            "bytes": out.stat().st_size,
            "seconds": round(time.perf_counter() - started, 3),
        }
        placed = placement_of(refined, out, z_scale=z_scale, keep_degrees=keep_degrees)
        nothing = "no triangle was chosen: the mesh is as before"
        summary["notes"] = [
            *([nothing] if refined.n_triangles == mesh.n_triangles else []),
            *filter(None, [placed.note]),
            *_doubts_about(mesh, grid),
        ]
        report(summary, as_json)


def _refined_or_refused(
    mesh: TriangleMesh, grid: Grid | None, asked: dict[str, Any], scheme: str, times: int
) -> TriangleMesh:
    from rtin import validity

    try:
        return _refined(mesh, grid, asked, scheme, times)
    except validity.InvalidMesh:
        if validity.is_closed(mesh):
            raise ValueError(
                "the mesh is a closed solid; refine the terrain before it gets a --base"
            ) from None
        raise


def _refined(
    mesh: TriangleMesh, grid: Grid | None, asked: dict[str, Any], scheme: str, times: int
) -> TriangleMesh:
    from rtin import selection
    from rtin.refinement import refine, refine_to

    if grid is not None and {"max_error", "threshold"} & asked.keys():
        return refine_to(mesh, grid, scheme=scheme, **asked)
    _require_numbers_for(mesh.n_triangles, asked.get("uniform", 0), scheme)
    targets: Any
    for _ in range(asked.get("uniform", times)):
        if "where" in asked:
            with values_are_usage():
                targets = selection.where(mesh, asked["where"])
        elif "triangles" in asked:
            targets = selection.read_numbers(asked["triangles"])
        else:
            targets = range(mesh.n_triangles)
        mesh = refine(mesh, targets, scheme, heights=grid)
    return mesh


def _require_numbers_for(n_triangles: int, n_times: int, scheme: str) -> None:
    """Refuse to refine so often that the triangles, at least so many, can't be numbered."""
    from rtin._adjacency import MOST_TRIANGLES

    n_children = 2 if scheme == "bisection" else 4
    if n_triangles * n_children ** min(n_times, 40) > MOST_TRIANGLES:
        raise typer.BadParameter(
            f"--uniform {n_times} would make more than the {MOST_TRIANGLES} triangles "
            "that can be numbered"
        )


def _require_same_crs(mesh: TriangleMesh, grid: Grid | None) -> None:
    if grid is None or None in (mesh.crs, grid.crs) or mesh.crs == grid.crs:
        return
    raise ValueError(
        f"the mesh is in {name_of(mesh.crs)}, the raster in {name_of(grid.crs)}; "
        "reproject one of them first"
    )


def _doubts_about(mesh: TriangleMesh, grid: Grid | None) -> list[str]:
    """Return a line for each sign that a mesh does not lie where its raster does."""
    import numpy as np

    if grid is None:
        return []
    doubts = []
    if mesh.crs is None and grid.crs is not None:
        doubts.append(f"the mesh has no CRS: taken to be in the raster's, {name_of(grid.crs)}")
    places = grid.places(mesh.vertices[:, :2])
    beside = (places < -0.5) | (places > np.subtract(grid.shape, 0.5))
    if beside.any():
        n = int(beside.any(axis=1).sum())
        doubts.append(f"{n} of the mesh's {mesh.n_vertices} vertices lie beside the raster")
    return doubts


def _achieved_by(mesh: TriangleMesh, grid: Grid) -> dict[str, Any]:
    """Return the figures to report, none where a mesh lies between the samples or beside them."""
    try:
        return achieved_figures(measured_error(mesh, grid))
    except ValueError:
        return {"achieved": "unknown: the mesh covers no sample of the raster"}
