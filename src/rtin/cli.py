"""The command line: parse, call, print. Heavy imports wait until a command needs them."""

from __future__ import annotations

import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rtin._console import (
    Band,
    Encoding,
    EncodingName,
    Json,
    give_up,
    interrupt,
    one_line,
    one_line_errors,
    progress,
    progress_bar,
    report,
    say,
    say_if_not_compiled,
    values_are_usage,
)
from rtin._tile_commands import serve, tiles
from rtin._version import __version__
from rtin._view_commands import view

if TYPE_CHECKING:
    from rtin.criteria import ErrorFigures, VerticalError
    from rtin.grid import Grid
    from rtin.mesh import TriangleMesh
    from rtin.overlay import TerrainDifference
    from rtin.studies.comparison import Method
    from rtin.tiles import HeightLattice

__all__ = ["app", "main"]

_USUAL = {"norm": "max", "diagonals": "lattice", "heights": "sampled"}  # not worth telling
_MOST_TAGS = 20  # shown
_GDALS_SHARE = 8  # of the memory for tiles: an eighth

app = typer.Typer(
    help="Adaptive triangle meshes from elevation rasters, with a guaranteed vertical error.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)

study = typer.Typer(help="Measure what the paper says.", no_args_is_help=True)
app.add_typer(study, name="study")

_Dem = Annotated[Path, typer.Argument(metavar="DEM", help="Any raster that GDAL reads, or .npy.")]
_Window = Annotated[
    tuple[int, int, int, int] | None,
    typer.Option(
        metavar="ROW ROW COL COL",
        help="Read only rows from the first to before the second number, and columns likewise.",
        show_default=False,
    ),
]
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
_MeshOut = Annotated[
    Path,
    typer.Argument(
        metavar="OUT", help="Mesh to write: .glb .obj .ply .stl .vtu .vtp .msh .xdmf .2dm .html."
    ),
]
_KeepDegrees = Annotated[
    bool, typer.Option("--keep-degrees", help="Do not scale degrees to metres.")
]
_ZScale = Annotated[float, typer.Option(help="Multiply written heights by this.")]


def main() -> None:
    """Run the ``rtin`` program."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    try:
        app()
    except OSError as error:  # of the help text itself: no space is left for it
        give_up(error)
        sys.exit(1)


@app.callback(invoke_without_command=True)
def _program(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)
    ] = False,
) -> None:
    if version:
        print(f"rtin {__version__}")
        raise typer.Exit


@app.command()
def coarsen(
    dem: _Dem,
    out: _MeshOut,
    max_error: _MaxError = None,
    max_vertices: _MaxVertices = None,
    max_triangles: _MaxTriangles = None,
    threshold: _Threshold = None,
    norm: _Norm = "max",
    weight: _Weight = None,
    diagonals: _Diagonals = "lattice",
    heights: _VertexHeights = "sampled",
    band: Band = 1,
    window: _Window = None,
    encoding: Encoding = None,
    z_scale: _ZScale = 1.0,
    base: Annotated[
        float | None,
        typer.Option(
            metavar="HEIGHT",
            help="Close the mesh to a solid for printing, this much deep below its lowest point.",
        ),
    ] = None,
    keep_degrees: _KeepDegrees = False,
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
    asked = _the_only_option(
        max_error=max_error,
        max_vertices=max_vertices,
        max_triangles=max_triangles,
        threshold=threshold,
        weight=weight,
    )
    _require_criterion_of(asked, norm)
    chosen = {"norm": norm, "diagonals": diagonals, "heights": heights}
    asked |= {name: value for name, value in chosen.items() if value != _USUAL[name]}
    _require_positive("--z-scale", z_scale)
    _require_positive("--base", base)
    limit = None if memory is None else _as_bytes("--memory", memory)
    with one_line_errors():
        from rtin.io.meshes import placement_of, write_mesh

        _require_writable(out, dem)
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


@app.command()
def refine(
    path: Annotated[Path, typer.Argument(metavar="MESH", help="A mesh that rtin reads.")],
    out: _MeshOut,
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
    window: _Window = None,
    encoding: Encoding = None,
    z_scale: _ZScale = 1.0,
    keep_degrees: _KeepDegrees = False,
    as_json: Json = False,
) -> None:
    """Refine a triangle mesh, locally or as a whole, and keep it conforming."""
    asked = _the_only_option(
        where=where,
        triangles=triangles,
        uniform=uniform,
        max_error=max_error,
        threshold=threshold,
    )
    is_fit = bool({"max_error", "threshold"} & asked.keys())
    if dem is None and is_fit:
        raise typer.BadParameter(f"{_flag(next(iter(asked)))} wants a raster to fit: --dem DEM")
    scheme = scheme or ("bisection" if is_fit else "4T-LE")
    if times > 1 and where is None:
        raise typer.BadParameter("--times goes with --where; for all triangles there is --uniform")
    _require_positive("--z-scale", z_scale)
    with one_line_errors():
        from rtin.io.meshes import placement_of, read_mesh, write_mesh

        _require_writable(out, dem)
        started = time.perf_counter()
        with progress(f"reading {path}"):
            mesh = read_mesh(path)
        grid = None if dem is None else _read_grid(dem, band, window, encoding)
        _require_same_crs(mesh, grid)
        with progress(f"refining {mesh.n_triangles} triangles"):
            refined = _refined_or_refused(mesh, grid, asked, scheme, times)
        achieved = {} if grid is None else _achieved_by(refined, grid)
        with progress(f"writing {out}"):
            write_mesh(refined, out, z_scale=z_scale, keep_degrees=keep_degrees)
        summary = {
            "input": str(path),
            "output": str(out),
            "before": _mesh_counts(mesh),
            **_mesh_counts(refined),
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


@app.command()
def info(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="A raster or a mesh.")],
    band: Band = 1,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Say what a raster or a mesh holds, and what is odd."""
    with one_line_errors():
        from rtin.io.meshes import is_mesh_path

        summary = _mesh_info(path) if is_mesh_path(path) else _grid_info(path, band, encoding)
        report(summary, as_json)


@app.command()
def plot(
    path: Annotated[Path, typer.Argument(metavar="MESH", help="A mesh that rtin reads.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Picture: .png .jpg .svg .pdf.")],
    dem: Annotated[
        Path | None, typer.Option(metavar="DEM", help="Raster to shade below the mesh.")
    ] = None,
    band: Band = 1,
    window: _Window = None,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Draw a mesh from above, over its raster's hillshade."""
    with one_line_errors():
        from rtin.io.meshes import read_mesh
        from rtin.plotting import require_picture_path, save_picture

        with values_are_usage():
            require_picture_path(out)
        with progress(f"reading {path}"):
            mesh = read_mesh(path)
        grid = None if dem is None else _read_grid(dem, band, window, encoding)
        with progress(f"drawing {out}"):
            save_picture(mesh, out, grid=grid)
        report({"input": str(path), "output": str(out), **_mesh_counts(mesh)}, as_json)


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A mesh or a raster that rtin reads.")],
    b: Annotated[
        Path | None, typer.Argument(metavar="[B]", help="Another one.", show_default=False)
    ] = None,
    max_error: Annotated[
        str | None,
        typer.Option(
            metavar="HEIGHTS",
            help="In place of B: tolerances to simplify the raster A to, apart by commas.",
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Other simplifiers to measure too, apart by commas, or all."
        ),
    ] = None,
    match: Annotated[
        Literal["vertices", "error"] | None,
        typer.Option(
            help="Others get as many vertices as the least mesh (by default), or its tolerance.",
            show_default=False,
        ),
    ] = None,
    sampling: Annotated[
        Literal["subdivision", "montecarlo", "similar", "vertices"],
        typer.Option(help="Where the samples of a triangle lie, as in Metro."),
    ] = "subdivision",
    samples: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Samples of each side; by default 10 a triangle.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Of montecarlo's samples.")] = 0,
    certified: Annotated[
        bool, typer.Option("--certified", help="Bound the Hausdorff distance too.")
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="HEIGHT",
            help="How far these bounds may be apart; by default 0.1 %.",
            show_default=False,
        ),
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table, for a spreadsheet.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a report with pictures: one page.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a map of the errors: .png .jpg .svg .pdf."),
    ] = None,
    band: Band = 1,
    window: _Window = None,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Measure how far two surfaces are from each other, or simplified meshes from their raster."""
    _require_comparable(a, b, max_error, against=against, match=match)
    _require_positive("--tolerance", tolerance)
    if tolerance is not None and not certified:
        raise typer.BadParameter("--tolerance goes with --certified")
    with one_line_errors():
        from rtin.studies.comparison import Method

        started = time.perf_counter()
        wanted = {"csv": csv, "html": html, "picture": picture}
        outputs = {name: out for name, out in wanted.items() if out is not None}
        _require_reports(outputs, a, b)
        method = Method(sampling, samples, seed, certified, tolerance)

        def read(path: Path) -> TriangleMesh | Grid:
            return _read_surface(path, band, window, encoding)

        if b is None:
            assert max_error is not None
            asked = max_error, against or "", match or "vertices"
            summary = _compared_with_others(a, asked, method, read, outputs, as_json)
        else:
            summary = _compared_pair((a, b), method, read, outputs, as_json)
        summary["seconds"] = round(time.perf_counter() - started, 3)
        summary["written"] = [str(out) for out in outputs.values()]
        summary["notes"] = summary.pop("notes")
        report(summary, as_json)


app.command()(tiles)
app.command()(serve)
app.command()(view)


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="Folder for the files made.")] = Path("demo"),
    max_error: Annotated[
        float, typer.Option(metavar="METRES", help="Tolerance to coarsen to.")
    ] = 50.0,
    as_json: Json = False,
) -> None:
    """Coarsen a real DEM into files to look at."""
    asked = _the_only_option(max_error=max_error)
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
            **_counts(grid, mesh),
            "asked": asked,
            **_achieved(error),
            "seconds": round(time.perf_counter() - started, 3),
            "written": [str(path) for path in written],
            "notes": ["heights are doubled in terrain.glb and terrain.html"],
        }
        report(summary, as_json)


@study.command("propagation")
def study_propagation(
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Folder for the pictures.")
    ] = Path("study-propagation"),
    seeds: Annotated[
        int, typer.Option(min=1, help="Runs, each with its own random numbers.")
    ] = 200,
    splits: Annotated[int, typer.Option(min=1, help="Refinements in each run.")] = 300,
    long: Annotated[
        bool, typer.Option("--long", help="Go on to a million refinements; takes minutes.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Measure how far refinement propagates: figure 3 of the paper, and beyond."""
    with one_line_errors():
        from rtin.studies import pictures, propagation

        started = time.perf_counter()
        pictures.require_places(out)
        measured = propagation.measure(seeds, splits, long=long, stage=progress)
        with progress(f"drawing {out}"):
            written = pictures.write_pictures(measured, out)
        rows = propagation.rows(measured)
        summary: dict[str, Any] = {
            "seeds": seeds,
            "splits": splits,
            "rows": [row._asdict() for row in rows],
            "seconds": round(time.perf_counter() - started, 3),
            "written": [str(path) for path in written],
        }
        if not as_json:
            print(propagation.as_text(rows), end="\n\n")
            del summary["rows"]
        report(summary, as_json)


@study.command("accuracy")
def study_accuracy(
    dem: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DEM]",
            help="Any raster that GDAL reads, or .npy; Jacksboro by default.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Folder for the pictures.")
    ] = Path("study-accuracy"),
    against: Annotated[
        str,
        typer.Option(metavar="NAMES", help="More simplifiers to compare with, apart by commas."),
    ] = "",
    band: Band = 1,
    window: _Window = None,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Measure how near meshes are to their terrain: Tables 1 to 3, figures 5 and 6 of the paper."""
    with one_line_errors():
        from rtin.studies import accuracy, accuracy_pictures

        started = time.perf_counter()
        with values_are_usage():
            names = accuracy.names_with(against)
        accuracy_pictures.require_places(out)
        grid = None if dem is None else _read_grid(dem, band, window, encoding)
        measured = accuracy.measure(grid, names, stage=progress)
        with progress(f"drawing {out}"):
            written = accuracy_pictures.write_pictures(measured, out)
            written.append(accuracy_pictures.write_figure_5(accuracy.close_up(grid), out))
        summary: dict[str, Any] = {
            "terrain": str(dem or "Jacksboro fault, Tennessee (matplotlib's sample data)"),
            "relief": measured.relief,
            "rows": [row.as_dict() for row in measured.rows],
            "at_thresholds": {f"{t:g}": n for t, n in measured.at_thresholds.items()},
            "seconds": round(time.perf_counter() - started, 3),
            "written": [str(path) for path in written],
            "notes": measured.notes,
        }
        if not as_json:
            print(accuracy.as_text(measured), accuracy.times_as_text(measured), sep="\n\n")
            print()
            del summary["rows"], summary["at_thresholds"], summary["notes"]
        report(summary, as_json)


# --- steps --------------------------------------------------------------------------------------


def _read_grid(
    dem: Path,
    band: int,
    window: tuple[int, int, int, int] | None,
    encoding: EncodingName | None,
) -> Grid:
    from rtin.io.grids import read_grid

    slices = None if window is None else ((window[0], window[1]), (window[2], window[3]))
    with progress(f"reading {dem}"):
        return read_grid(dem, window=slices, band=band, encoding=encoding)


def _coarsen_and_measure(grid: Grid, asked: dict[str, Any]) -> tuple[TriangleMesh, VerticalError]:
    from rtin.coarsening import coarsen

    say_if_not_compiled()
    rows, cols = grid.shape
    with progress(f"coarsening {rows} × {cols} samples"):
        mesh = coarsen(grid, **asked)
    return mesh, _measured(mesh, grid)


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
    grid = _read_grid(dem, *how)
    mesh, error = _coarsen_and_measure(grid, asked)
    return mesh, _counts(grid, mesh), _achieved(error), _warnings_about(grid)


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
        **_mesh_counts(mesh),
    }
    notes = [f"{dem.name} was read in tiles: as a whole it would need more than the memory allowed"]
    return mesh, counts, _achieved(error), [*notes, *fills.lines(), *_warnings_about_crs(mesh.crs)]


def _measured(mesh: TriangleMesh, grid: Grid) -> VerticalError:
    from rtin.criteria import vertical_error

    with progress("measuring the achieved error"):
        return vertical_error(mesh, grid)


def _require_same_crs(mesh: TriangleMesh, grid: Grid | None) -> None:
    if grid is None or None in (mesh.crs, grid.crs) or mesh.crs == grid.crs:
        return
    raise ValueError(
        f"the mesh is in {_name_of(mesh.crs)}, the raster in {_name_of(grid.crs)}; "
        "reproject one of them first"
    )


def _doubts_about(mesh: TriangleMesh, grid: Grid | None) -> list[str]:
    """Return a line for each sign that a mesh does not lie where its raster does."""
    import numpy as np

    if grid is None:
        return []
    doubts = []
    if mesh.crs is None and grid.crs is not None:
        doubts.append(f"the mesh has no CRS: taken to be in the raster's, {_name_of(grid.crs)}")
    places = grid.places(mesh.vertices[:, :2])
    beside = (places < -0.5) | (places > np.subtract(grid.shape, 0.5))
    if beside.any():
        n = int(beside.any(axis=1).sum())
        doubts.append(f"{n} of the mesh's {mesh.n_vertices} vertices lie beside the raster")
    return doubts


def _achieved_by(mesh: TriangleMesh, grid: Grid) -> dict[str, Any]:
    """Return the figures to report, none where a mesh lies between the samples or beside them."""
    try:
        return _achieved(_measured(mesh, grid))
    except ValueError:
        return {"achieved": "unknown: the mesh covers no sample of the raster"}


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


def _warnings_about(grid: Grid) -> list[str]:
    """Return a line for each thing about a raster that its mesh will not show by itself."""
    from rtin.io.grids import suspicious_values

    return [*suspicious_values(grid), *_warnings_about_crs(grid.crs)]


def _warnings_about_crs(crs: Any) -> list[str]:  # noqa: ANN401  (pyproj is imported where needed)
    if crs is None:
        return ["the raster has no CRS: x and y are taken to be in the unit of the heights"]
    if crs.to_epsg() == 3857:
        return ["EPSG:3857 is not to scale: reproject the raster for true proportions"]
    return []


def _grid_info(path: Path, band: int, encoding: EncodingName | None) -> dict[str, Any]:
    import numpy as np

    from rtin.io.grids import suspicious_values

    grid = _read_grid(path, band, None, encoding)
    rows, cols = grid.shape
    return {
        "input": str(path),
        "rows": rows,
        "cols": cols,
        "samples": grid.n_samples,
        "voids": rows * cols - grid.n_samples,
        "lowest": float(np.nanmin(grid.heights)),
        "highest": float(np.nanmax(grid.heights)),
        "type": str(grid.heights.dtype),
        "crs": _name_of(grid.crs),
        "transform": list(grid.transform)[:6],
        "suspicious": suspicious_values(grid),
    }


def _mesh_info(path: Path) -> dict[str, Any]:
    from rtin.io.meshes import read_mesh
    from rtin.validity import complaints, is_closed

    with progress(f"reading {path}"):
        mesh = read_mesh(path)
    low, high = mesh.bounds
    solid = is_closed(mesh)
    return {
        "input": str(path),
        **_mesh_counts(mesh),
        "from": low.tolist(),
        "to": high.tolist(),
        "crs": _name_of(mesh.crs),
        "solid": solid,
        "tags": [] if mesh.tags is None else _counts_of_tags(mesh.tags),
        "complaints": [] if solid else complaints(mesh),
    }


def _counts_of_tags(tags: Any) -> list[str]:  # noqa: ANN401  (NumPy is imported where needed)
    """Return the commonest tags with their numbers of triangles."""
    import numpy as np

    found, counts = np.unique(tags, return_counts=True)
    order = np.argsort(-counts, kind="stable")[:_MOST_TAGS]
    more = ["…"] if len(found) > _MOST_TAGS else []
    return [f"{found[i]} ({counts[i]} triangles)" for i in order] + more


def _name_of(crs: Any) -> str | None:  # noqa: ANN401  (pyproj is imported where needed)
    if crs is None:
        return None
    authority = crs.to_authority()
    return ":".join(authority) if authority else str(crs.name)


def _mesh_counts(mesh: TriangleMesh) -> dict[str, int]:
    return {"vertices": mesh.n_vertices, "triangles": mesh.n_triangles}


def _counts(grid: Grid, mesh: TriangleMesh) -> dict[str, int]:
    rows, cols = grid.shape
    return {"rows": rows, "cols": cols, "samples": grid.n_samples, **_mesh_counts(mesh)}


def _achieved(error: ErrorFigures) -> dict[str, Any]:
    figures: dict[str, Any] = {"max_error": error.max, "rms": error.rms, "mean": error.mean}
    return {"achieved": figures, "uncovered_samples": error.n_uncovered}


# --- comparing ----------------------------------------------------------------------------------


_Reader = Callable[[Path], "TriangleMesh | Grid"]


def _require_comparable(a: Path, b: Path | None, max_error: str | None, **others: Any) -> None:  # noqa: ANN401
    """Refuse neither or both of what A can be compared with, and what goes with the other one."""
    if (b is None) == (max_error is None):
        got = "neither" if b is None else "both"
        raise typer.BadParameter(f"B or --max-error is wanted to compare {a} with, got {got}")
    for name, value in others.items():
        if b is not None and value is not None:
            raise typer.BadParameter(f"{_flag(name)} goes with --max-error, in place of B")


def _require_reports(outputs: dict[str, Path], *inputs: Path | None) -> None:
    """Refuse outputs that can't be written, or would be written over an input or each other."""
    from rtin.plotting import require_picture_path
    from rtin.studies.comparison_report import require_path

    taken = {path.resolve() for path in inputs if path is not None}
    for name, out in outputs.items():
        if out.resolve() in taken:
            raise typer.BadParameter(f"--{name} must be a file of its own, got {out}")
        taken.add(out.resolve())
        with values_are_usage():
            if name == "picture":
                require_picture_path(out)
            else:
                require_path(out, [".csv"] if name == "csv" else [".html", ".htm"])


def _read_surface(
    path: Path,
    band: int,
    window: tuple[int, int, int, int] | None,
    encoding: EncodingName | None,
) -> TriangleMesh | Grid:
    from rtin.io.meshes import is_mesh_path, read_mesh

    if not is_mesh_path(path):
        return _read_grid(path, band, window, encoding)
    with progress(f"reading {path}"):
        return read_mesh(path)


def _compared_pair(
    paths: tuple[Path, Path],
    method: Method,
    read: _Reader,
    outputs: dict[str, Path],
    as_json: bool,
) -> dict[str, Any]:
    """Compare two files and write what is wanted; return the summary, notes last."""
    from rtin.studies import comparison, comparison_pictures, comparison_report

    say_if_not_compiled("rtin.distance", seconds=30)
    a, b = (read(path) for path in paths)
    pair = comparison.measure_pair(a, b, method, stage=progress_bar)
    names = (paths[0].name, paths[1].name)
    _write_reports(outputs, {
        "csv": lambda: comparison_report.csv_of_pair(pair),
        "html": lambda: comparison_report.page_of_pair(pair, names, pair.notes),
        "picture": lambda: comparison_pictures.write_pair(pair, outputs["picture"]),
    })  # fmt: skip
    counts = zip(paths, pair.counts(), strict=True)
    files = [{"input": str(path), **found, "bytes": path.stat().st_size} for path, found in counts]
    summary: dict[str, Any] = {"a": files[0], "b": files[1], "sampling": method.sampling}
    if as_json:
        summary |= comparison.sides_as_dicts(pair.distance)
    else:
        print(comparison.pair_as_text(pair), end="\n\n")
    summary["hausdorff"] = pair.distance.hausdorff
    if pair.certified is not None:
        lower, upper, place = (getattr(pair.certified, x) for x in ("lower", "upper", "place"))
        summary["certified"] = {"lower": lower, "upper": upper, "place": list(place)}
    if pair.vertical is not None:
        summary["vertical"] = _vertical_figures(pair.vertical)
    if pair.difference is not None:
        summary["b_minus_a"] = _figures_of(pair.difference)
    return {**summary, "notes": pair.notes}


def _figures_of(difference: TerrainDifference) -> dict[str, Any]:
    names = ("min", "max", "mean", "mean_abs", "rms", "fill", "cut", "area")
    figures = {name: getattr(difference, name) for name in names}
    for name, angles in (("normals", difference.normals), ("slope", difference.slope)):
        figures |= {f"{name}_{x}_degrees": value for x, value in angles._asdict().items()}
    return figures


def _vertical_figures(error: VerticalError) -> dict[str, Any]:
    row, col = error.sample
    figures = {"max": error.max, "rms": error.rms, "mean": error.mean, "row": row, "col": col}
    return {**figures, "uncovered_samples": error.n_uncovered}


def _compared_with_others(
    path: Path,
    asked: tuple[str, str, Literal["vertices", "error"]],
    method: Method,
    read: _Reader,
    outputs: dict[str, Path],
    as_json: bool,
) -> dict[str, Any]:
    """Compare simplified meshes and write what is wanted; return the summary, notes last."""
    from rtin.grid import Grid
    from rtin.io.meshes import is_mesh_path
    from rtin.studies import comparison, comparison_pictures, comparison_report

    if is_mesh_path(path):
        raise typer.BadParameter(f"--max-error wants a raster to simplify, got the mesh {path}")
    with values_are_usage():
        tolerances = comparison.tolerances_in(asked[0])
        names = comparison.names_in(asked[1])
    say_if_not_compiled("rtin.distance", seconds=30)
    grid = read(path)
    assert isinstance(grid, Grid)
    found = comparison.measure(
        grid, tolerances, names, match=asked[2], method=method, stage=progress_bar
    )
    notes = [*found.notes, *_warnings_about(grid)]
    _write_reports(outputs, {
        "csv": lambda: comparison_report.csv_of_comparison(found),
        "html": lambda: comparison_report.page_of_comparison(found, path.name, notes),
        "picture": lambda: comparison_pictures.write_maps(found, outputs["picture"]),
    })  # fmt: skip
    summary: dict[str, Any] = {"input": str(path), "samples": grid.n_samples, "match": found.match}
    if as_json:
        summary["rows"] = [row.as_dict() for row in found.rows]
    else:
        print(comparison.as_text(found), end="\n\n")
    return {**summary, "notes": notes}


def _write_reports(outputs: dict[str, Path], make: dict[str, Callable[[], bytes | None]]) -> None:
    """Write what is wanted; what gives no bytes writes for itself."""
    from rtin._atomic import write_bytes

    for name, out in outputs.items():
        with progress(f"writing {out}"):
            made = make[name]()
            if made is not None:
                write_bytes(out, made)


# --- options ------------------------------------------------------------------------------------


def _the_only_option(**options: float | str | Path | None) -> dict[str, Any]:
    """Return the one option given of several; none, more, and negative ones are bad usage."""
    given = {name: value for name, value in options.items() if value is not None}
    flags = ", ".join(_flag(name) for name in options)
    if len(given) != 1:
        got = " and ".join(_flag(name) for name in given) or "none"
        raise typer.BadParameter(f"exactly one of {flags} is wanted, got {got}")
    name, value = next(iter(given.items()))
    if isinstance(value, int | float) and not value >= 0:
        raise typer.BadParameter(f"{_flag(name)} must be zero or more, got {value}")
    return given


def _require_criterion_of(asked: dict[str, Any], norm: str) -> None:
    """Refuse a criterion that does not go with the norm."""
    (name,) = asked
    if norm == "max" and name == "weight":
        raise typer.BadParameter("--weight goes with --norm rms")
    if norm == "rms" and name not in ("max_vertices", "max_triangles", "weight"):
        raise typer.BadParameter(
            f"--norm rms goes with --max-vertices, --max-triangles or --weight, got {_flag(name)}"
        )


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _as_bytes(flag: str, text: str) -> int:
    from rtin._memory import as_bytes

    try:
        return as_bytes(text)
    except ValueError as error:
        raise typer.BadParameter(f"{flag}: {error}") from None


def _require_positive(flag: str, value: float | None) -> None:
    if value is not None and not 0.0 < value < float("inf"):
        raise typer.BadParameter(f"{flag} must be more than zero, got {value}")


def _require_numbers_for(n_triangles: int, n_times: int, scheme: str) -> None:
    """Refuse to refine so often that the triangles, at least so many, can't be numbered."""
    from rtin._adjacency import MOST_TRIANGLES

    n_children = 2 if scheme == "bisection" else 4
    if n_triangles * n_children ** min(n_times, 40) > MOST_TRIANGLES:
        raise typer.BadParameter(
            f"--uniform {n_times} would make more than the {MOST_TRIANGLES} triangles "
            "that can be numbered"
        )


def _require_writable(out: Path, dem: Path | None) -> None:
    """Refuse an output that can't be written before any work is done."""
    from rtin.io.meshes import require_writable

    if dem is not None and out.exists() and dem.exists() and out.samefile(dem):
        raise typer.BadParameter(f"OUT must not be the raster itself, got {out} for both")
    with values_are_usage():
        require_writable(out)


# --- messages -----------------------------------------------------------------------------------
