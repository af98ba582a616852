"""The commands ``rtin coarsen`` and ``rtin demo``."""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rtin._commands._console import (
    Json,
    one_line,
    one_line_errors,
    progress,
    progress_bar,
    report,
    say,
    say_if_not_compiled,
)
from rtin._commands._surfaces import (
    Band,
    Dem,
    Encoding,
    EncodingName,
    KeepDegrees,
    MeshOut,
    Window,
    ZScale,
    achieved_figures,
    counts_of,
    measured_error,
    mesh_counts,
    read_raster,
    warnings_about,
    warnings_about_crs,
)
from rtin._commands._usage import (
    bytes_in,
    flag_of,
    require_mesh_out,
    require_positive,
    the_only_option,
)

if TYPE_CHECKING:
    from rtin.criteria import VerticalError
    from rtin.grid import Grid
    from rtin.mesh import TriangleMesh
    from rtin.tiles import HeightLattice

__all__ = ["coarsen", "demo"]


_USUAL = {"norm": "max", "diagonals": "lattice", "heights": "sampled"}  # not worth telling
_GDALS_SHARE = 8  # of the memory for tiles: an eighth
_MaxError = Annotated[
    float | None,
    typer.Option(
        metavar="HEIGHT",
        help="Least mesh with every sample within this vertical distance, in the raster's units.",
    ),
]
_MaxVertices = Annotated[
    int | None, typer.Option(metavar="N", help="Best mesh of at most N vertices.")
]
_MaxTriangles = Annotated[
    int | None, typer.Option(metavar="N", help="Best mesh of at most N triangles.")
]
_Threshold = Annotated[
    float | None,
    typer.Option(
        metavar="HEIGHT", help="The paper's local criterion, Eq. (1): no promise on the surface."
    ),
]
_Norm = Annotated[
    Literal["max", "rms"],
    typer.Option(help="What a budget makes small: the largest error, or the root mean square."),
]
_Weight = Annotated[
    float | None,
    typer.Option(
        metavar="SQUARE",
        help="With --norm rms: least fall of the sum of squared errors for one more vertex.",
    ),
]
_Diagonals = Annotated[
    Literal["lattice", "best"],
    typer.Option(help="best: squares may change their diagonals, which takes fewer vertices."),
]
_VertexHeights = Annotated[
    Literal["sampled", "fitted"],
    typer.Option(help="Leave vertices at the raster's heights, or fit them to all samples."),
]


def coarsen(
    dem: Dem,
    out: MeshOut,
    max_error: _MaxError = None,
    max_vertices: _MaxVertices = None,
    max_triangles: _MaxTriangles = None,
    threshold: _Threshold = None,
    norm: _Norm = "max",
    weight: _Weight = None,
    diagonals: _Diagonals = "lattice",
    heights: _VertexHeights = "sampled",
    band: Band = 1,
    window: Window = None,
    encoding: Encoding = None,
    z_scale: ZScale = 1.0,
    base: Annotated[
        float | None,
        typer.Option(
            metavar="HEIGHT",
            help="Close the mesh to a solid for printing, this much deep below its lowest point.",
        ),
    ] = None,
    keep_degrees: KeepDegrees = False,
    memory: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Read a raster that needs more than this in tiles, to the same mesh: 500MB, 2GB, "
            "1.5GiB; by default half of what is at hand.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Coarsen a raster to a mesh."""
    asked = the_only_option(
        max_error=max_error,
        max_vertices=max_vertices,
        max_triangles=max_triangles,
        threshold=threshold,
        weight=weight,
    )
    _require_criterion_of(asked, norm)
    chosen = {"norm": norm, "diagonals": diagonals, "heights": heights}
    asked |= {name: value for name, value in chosen.items() if value != _USUAL[name]}
    require_positive("--z-scale", z_scale)
    require_positive("--base", base)
    limit = None if memory is None else bytes_in("--memory", memory)
    with one_line_errors():
        from rtin.io.meshes import placement_of, write_mesh

        require_mesh_out(out, dem)
        started = time.perf_counter()
        mesh, counts, achieved, notes = _coarsened(limit, asked, dem, band, window, encoding)
        with progress(f"writing {out}"):
            write_mesh(mesh, out, z_scale=z_scale, base=base, keep_degrees=keep_degrees)
        summary = {
            "input": str(dem),
            "output": str(out),
            **counts,
            "asked": asked,
            **achieved,
            "bytes": out.stat().st_size,
            "seconds": round(time.perf_counter() - started, 3),
        }
        placed = placement_of(mesh, out, z_scale=z_scale, keep_degrees=keep_degrees)
        summary["notes"] = [*filter(None, [placed.note]), *notes]
        report(summary, as_json)


def demo(
    folder: Annotated[Path, typer.Argument(help="Folder for the files made.")] = Path("demo"),
    max_error: Annotated[
        float, typer.Option(metavar="METRES", help="Tolerance to coarsen to.")
    ] = 50.0,
    as_json: Json = False,
) -> None:
    """Coarsen a real DEM into files to look at."""
    asked = the_only_option(max_error=max_error)
    with one_line_errors():
        from rtin import samples
        from rtin.io.meshes import write_mesh
        from rtin.plotting import save_picture

        started = time.perf_counter()
        folder.mkdir(parents=True, exist_ok=True)
        grid = samples.jacksboro_fault()
        mesh, error = _coarsen_and_measure(grid, asked)
        written = [folder / name for name in ("terrain.glb", "terrain.html", "terrain.png")]
        with progress(f"writing {folder}"):
            write_mesh(mesh, written[0], z_scale=2.0)
            write_mesh(mesh, written[1], z_scale=2.0)
            save_picture(mesh, written[2], grid=grid)
        summary = {
            "terrain": "Jacksboro fault, Tennessee (matplotlib's sample data)",
            **counts_of(grid, mesh),
            "asked": asked,
            **achieved_figures(error),
            "seconds": round(time.perf_counter() - started, 3),
            "written": [str(path) for path in written],
            "notes": ["heights are doubled in terrain.glb and terrain.html"],
        }
        report(summary, as_json)


def _coarsened(
    limit: int | None,
    asked: dict[str, Any],
    dem: Path,
    *how: Any,  # noqa: ANN401
) -> tuple[TriangleMesh, dict[str, Any], dict[str, Any], list[str]]:
    """Coarsen a raster, in tiles where it needs more memory than the limit.

    Returns the mesh, counts and figures for the summary, and notes.
    """
    lattice = _lattice_beyond(limit, asked, dem, *how)
    if lattice is not None:
        return _coarsened_in_tiles(lattice, _limit_or_usual(limit), dem, asked["max_error"])
    grid = read_raster(dem, *how)
    mesh, error = _coarsen_and_measure(grid, asked)
    return mesh, counts_of(grid, mesh), achieved_figures(error), warnings_about(grid)


def _coarsen_and_measure(grid: Grid, asked: dict[str, Any]) -> tuple[TriangleMesh, VerticalError]:
    from rtin.coarsening import coarsen

    say_if_not_compiled()
    rows, cols = grid.shape
    with progress(f"coarsening {rows} × {cols} samples"):
        mesh = coarsen(grid, **asked)
    return mesh, measured_error(mesh, grid)


def _limit_or_usual(limit: int | None) -> int:
    """Return the memory that a raster may need: half of that at hand, if no limit is given."""
    from rtin.io.grids import available_memory

    if limit is not None:
        return limit
    available = available_memory()
    return sys.maxsize if available is None else available // 2


def _lattice_beyond(
    limit: int | None,
    asked: dict[str, Any],
    dem: Path,
    band: int,
    window: tuple[int, int, int, int] | None,
    encoding: EncodingName | None,
) -> HeightLattice | None:
    """Return a raster that is to be coarsened in tiles, None for one to be read as a whole.

    That is one that fits in memory, one that can't be opened, for ``read_grid`` to say why, and
    without a limit given one that is asked for more than tiles can do.
    """
    from rtin._memory import as_text
    from rtin.out_of_core import memory_of_coarsen

    try:
        with warnings.catch_warnings(record=True, action="always") as caught:
            lattice: HeightLattice = _open_lattice(dem, band, window, encoding)
            needed = memory_of_coarsen(lattice)
    except (OSError, ValueError, TypeError, IndexError):
        return None
    if needed <= _limit_or_usual(limit):
        return None
    if asked.keys() == {"max_error"}:
        for warning in caught:  # of a raster that is read as a whole they come then
            say(one_line(str(warning.message)))
        return lattice
    if limit is not None:
        raise MemoryError(
            f"{dem} needs {as_text(needed)}, and the limit is {as_text(limit)}: in tiles it can be "
            "coarsened by --max-error alone; or give more --memory, or a --window"
        )
    return None


def _open_lattice(
    dem: Path,
    band: int,
    window: tuple[int, int, int, int] | None,
    encoding: EncodingName | None,
) -> Any:  # noqa: ANN401
    from rtin.io.lattices import RasterLattice
    from rtin.out_of_core import LatticeWindow

    lattice: Any = RasterLattice(dem, band=band, encoding=encoding)
    if window is None:
        return lattice
    return LatticeWindow(lattice, (window[0], window[1]), (window[2], window[3]))


def _coarsened_in_tiles(
    lattice: HeightLattice, limit: int, dem: Path, max_error: float
) -> tuple[TriangleMesh, dict[str, Any], dict[str, Any], list[str]]:
    import rasterio

    from rtin.io.grids import FillValues
    from rtin.out_of_core import coarsen_lattice, lattice_error

    say_if_not_compiled()
    shape = tuple(end - first for first, end in (lattice.rows, lattice.cols))
    fills = FillValues()
    # GDAL would keep a twentieth of the machine's memory of what it has read.
    with rasterio.Env(GDAL_CACHEMAX=limit // _GDALS_SHARE):
        with progress_bar(f"coarsening {shape[0]} × {shape[1]} samples in tiles") as tell:
            mesh = coarsen_lattice(lattice, max_error=max_error, memory=limit, tell=tell)
        with progress_bar("measuring the achieved error") as tell:
            error = lattice_error(mesh, lattice, memory=limit, look=fills.look, tell=tell)
    counts = {
        "rows": shape[0],
        "cols": shape[1],
        "samples": error.n_samples + error.n_uncovered,
        **mesh_counts(mesh),
    }
    notes = [f"{dem.name} was read in tiles: as a whole it would need more than the memory allowed"]
    notes += [*fills.lines(), *warnings_about_crs(mesh.crs)]
    return mesh, counts, achieved_figures(error), notes


def _require_criterion_of(asked: dict[str, Any], norm: str) -> None:
    """Refuse a criterion that does not go with the norm."""
    (name,) = asked
    if norm == "max" and name == "weight":
        raise typer.BadParameter("--weight goes with --norm rms")
    if norm == "rms" and name not in ("max_vertices", "max_triangles", "weight"):
        raise typer.BadParameter(
            f"--norm rms goes with --max-vertices, --max-triangles or --weight, got {flag_of(name)}"
        )
