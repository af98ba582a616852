"""The command ``rtin compare``."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rtin._commands._console import (
    Json,
    one_line_errors,
    progress,
    progress_bar,
    report,
    say_if_not_compiled,
)
from rtin._commands._surfaces import (
    Band,
    Encoding,
    EncodingName,
    Window,
    read_raster,
    warnings_about,
)
from rtin._commands._usage import flag_of, require_positive, values_are_usage

if TYPE_CHECKING:
    from rtin.criteria import VerticalError
    from rtin.grid import Grid
    from rtin.mesh import TriangleMesh
    from rtin.overlay import TerrainDifference
    from rtin.studies.comparison import Method

__all__ = ["compare"]

_Reader = Callable[[Path], "TriangleMesh | Grid"]


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
    window: Window = None,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Measure how far two surfaces are from each other, or simplified meshes from their raster."""
    _require_comparable(a, b, max_error, against=against, match=match)
    require_positive("--tolerance", tolerance)
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


def _require_comparable(a: Path, b: Path | None, max_error: str | None, **others: Any) -> None:  # noqa: ANN401
    """Refuse neither or both of what A can be compared with, and what goes with the other one."""
    if (b is None) == (max_error is None):
        got = "neither" if b is None else "both"
        raise typer.BadParameter(f"B or --max-error is wanted to compare {a} with, got {got}")
    for name, value in others.items():
        if b is not None and value is not None:
            raise typer.BadParameter(f"{flag_of(name)} goes with --max-error, in place of B")


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
        return read_raster(path, band, window, encoding)
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
    notes = [*found.notes, *warnings_about(grid)]
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
