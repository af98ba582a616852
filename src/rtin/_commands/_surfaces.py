"""What commands share that read rasters and write meshes: options, reading, figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rtin._commands._console import progress

if TYPE_CHECKING:
    from rtin.criteria import ErrorFigures, VerticalError
    from rtin.grid import Grid
    from rtin.mesh import TriangleMesh

__all__ = [
    "Band",
    "Dem",
    "Encoding",
    "EncodingName",
    "KeepDegrees",
    "MeshOut",
    "Window",
    "ZScale",
    "achieved_figures",
    "counts_of",
    "measured_error",
    "mesh_counts",
    "name_of",
    "read_raster",
    "warnings_about",
    "warnings_about_crs",
]


Band = Annotated[int, typer.Option(min=1, help="Band to read, from 1 on.")]
EncodingName = Literal["terrain-rgb", "terrarium", "none"]
Encoding = Annotated[
    EncodingName | None,
    typer.Option(help="How the colours of a tile hold heights; none: they are heights."),
]
Dem = Annotated[Path, typer.Argument(metavar="DEM", help="Any raster that GDAL reads, or .npy.")]
Window = Annotated[
    tuple[int, int, int, int] | None,
    typer.Option(
        metavar="ROW ROW COL COL",
        help="Read only rows from the first to before the second number, and columns likewise.",
        show_default=False,
    ),
]
MeshOut = Annotated[
    Path,
    typer.Argument(
        metavar="OUT", help="Mesh to write: .glb .obj .ply .stl .vtu .vtp .msh .xdmf .2dm .html."
    ),
]
KeepDegrees = Annotated[
    bool, typer.Option("--keep-degrees", help="Do not scale degrees to metres.")
]
ZScale = Annotated[float, typer.Option(help="Multiply written heights by this.")]


def read_raster(
    dem: Path,
    band: int,
    window: tuple[int, int, int, int] | None,
    encoding: EncodingName | None,
) -> Grid:
    from rtin.io.grids import read_grid

    slices = None if window is None else ((window[0], window[1]), (window[2], window[3]))
    with progress(f"reading {dem}"):
        return read_grid(dem, window=slices, band=band, encoding=encoding)


def measured_error(mesh: TriangleMesh, grid: Grid) -> VerticalError:
    from rtin.criteria import vertical_error

    with progress("measuring the achieved error"):
        return vertical_error(mesh, grid)


def warnings_about(grid: Grid) -> list[str]:
    """Return a line for each thing about a raster that its mesh will not show by itself."""
    from rtin.io.grids import suspicious_values

    return [*suspicious_values(grid), *warnings_about_crs(grid.crs)]


def warnings_about_crs(crs: Any) -> list[str]:  # noqa: ANN401  (pyproj is imported where needed)
    if crs is None:
        return ["the raster has no CRS: x and y are taken to be in the unit of the heights"]
    if crs.to_epsg() == 3857:
        return ["EPSG:3857 is not to scale: reproject the raster for true proportions"]
    return []


def name_of(crs: Any) -> str | None:  # noqa: ANN401  (pyproj is imported where needed)
    if crs is None:
        return None
    authority = crs.to_authority()
    return ":".join(authority) if authority else str(crs.name)


def mesh_counts(mesh: TriangleMesh) -> dict[str, int]:
    return {"vertices": mesh.n_vertices, "triangles": mesh.n_triangles}


def counts_of(grid: Grid, mesh: TriangleMesh) -> dict[str, int]:
    rows, cols = grid.shape
    return {"rows": rows, "cols": cols, "samples": grid.n_samples, **mesh_counts(mesh)}


def achieved_figures(error: ErrorFigures) -> dict[str, Any]:
    figures: dict[str, Any] = {"max_error": error.max, "rms": error.rms, "mean": error.mean}
    return {"achieved": figures, "uncovered_samples": error.n_uncovered}
