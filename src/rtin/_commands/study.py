"""The commands of ``rtin study``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from rtin._commands._console import Json, one_line_errors, progress, report
from rtin._commands._surfaces import Band, Encoding, Window, read_raster
from rtin._commands._usage import values_are_usage

__all__ = ["study_accuracy", "study_propagation"]


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
    window: Window = None,
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
        grid = None if dem is None else read_raster(dem, band, window, encoding)
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
