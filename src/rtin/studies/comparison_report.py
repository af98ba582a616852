"""The reports of ``rtin compare``: tables for spreadsheets, and pages to read."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rtin._atomic import require_place
from rtin.studies import comparison_pictures as pictures
from rtin.studies import page
from rtin.studies.comparison import Comparison, Pair, Row, label_of, sides_as_dicts

__all__ = ["csv_of_comparison", "csv_of_pair", "page_of_comparison", "page_of_pair", "require_path"]


def require_path(path: str | os.PathLike[str], suffixes: Sequence[str]) -> None:
    """Raise now what writing a report would because of its path, before the work is done.

    Raises
    ------
    ValueError
        If the extension is another one.
    OSError
        If no file can be put there.
    """
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"the extension must be {' or '.join(suffixes)}, got {os.fspath(path)}")
    require_place(path)


# --- for spreadsheets ---------------------------------------------------------------------------


def csv_of_pair(pair: Pair) -> bytes:
    """Return the figures of both directions, one in a row."""
    rows = []
    for way, side in sides_as_dicts(pair.distance).items():
        x, y, z = side.pop("place")
        rows.append({"direction": way, **side, "x": x, "y": y, "z": z})
        if pair.certified is not None:
            bounds = getattr(pair.certified, way)
            rows[-1] |= {"lower": bounds.lower, "upper": bounds.upper}
    return _csv(rows)


def csv_of_comparison(comparison: Comparison) -> bytes:
    """Return the figures of all meshes, one in a row."""
    rows = [row.as_dict() for row in comparison.rows]
    return _csv([{**row, "faults": "; ".join(row["faults"])} for row in rows])


def _csv(rows: list[dict[str, Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


# --- for people ---------------------------------------------------------------------------------


def page_of_pair(pair: Pair, names: tuple[str, str], notes: Sequence[str]) -> bytes:
    """Return a page on two surfaces, A and B, that have these names."""
    counts = [
        [letter, name, *(_number(value) for value in found.values())]
        for letter, name, found in zip("AB", names, pair.counts(), strict=True)
    ]
    sides = sides_as_dicts(pair.distance)
    places = [
        f"The largest from {way} is at x {x:.10g}, y {y:.10g}, z {z:.10g}."
        for way, (x, y, z) in zip(
            ("A to B", "B to A"), (side.pop("place") for side in sides.values()), strict=True
        )
    ]
    there, back = sides.values()
    figures = [
        [name.replace("_", " "), "", _number(value), _number(back[name])]
        for name, value in there.items()
    ]
    return page.page(
        f"{names[0]} and {names[1]}",
        [
            page.table(["", "surface", "vertices", "triangles"], counts),
            page.paragraphs(_said_of(pair)),
            page.table(["distance", "", "A to B", "B to A"], figures),
            page.paragraphs([*places, *notes]),
            *_drawn(pictures.of_pair(pair)),
        ],
    )


def _said_of(pair: Pair) -> list[str]:
    lines = [f"Hausdorff distance: {pair.distance.hausdorff:.6g} or more, from samples."]
    if pair.certified is not None:
        lower, upper = pair.certified.lower, pair.certified.upper
        lines[0] = f"Hausdorff distance: from {lower:.6g} to {upper:.6g}, certified."
    if pair.vertical is not None:
        error = pair.vertical
        lines.append(
            f"Vertical errors at the raster's samples: max {error.max:.6g}, rms {error.rms:.6g}, "
            f"mean {error.mean:.6g}; {error.n_uncovered} samples uncovered."
        )
    if pair.difference is not None:
        found = pair.difference
        lines.append(
            f"B less A at the same places: {found.min:.6g} to {found.max:.6g}, mean "
            f"{found.mean:.6g}, rms {found.rms:.6g}; fill {found.fill:.6g}, cut {found.cut:.6g} "
            f"over an area of {found.area:.6g}. Normals differ by {found.normals.mean:.4g}° on "
            f"average, slopes by {found.slope.rms:.4g}° rms."
        )
    return lines


def page_of_comparison(comparison: Comparison, name: str, notes: Sequence[str]) -> bytes:
    """Return a page on the simplified meshes of a raster of this name."""
    rows, cols = comparison.grid.shape
    tolerances = ", ".join(f"{value:g}" for value in comparison.tolerances())
    same = {
        "vertices": "Each gets at most as many vertices as the least mesh for the tolerance.",
        "error": "Each gets the same tolerance.",
    }
    firsts = [
        number
        for number, (row, before) in enumerate(
            zip(comparison.rows, [None, *comparison.rows], strict=False)
        )
        if before is None or row.max_error != before.max_error
    ]
    return page.page(
        f"Simplified meshes of {name}",
        [
            page.paragraphs([
                f"{rows} × {cols} samples, {comparison.grid.n_samples:,} of them valid; "
                f"max error {tolerances}. {same[comparison.match]}",
                "Max, rms and mean are vertical, over all samples that a mesh covers; the "
                "Hausdorff distance is Euclidean, in both directions; lengths are in the unit of "
                "the heights, bytes those of a GLB, seconds those of the simplification alone.",
            ]),
            page.table(_HEAD, map(_cells, comparison.rows), firsts=firsts),
            page.paragraphs(notes),
            *_drawn(pictures.of_comparison(comparison)),
        ],
    )  # fmt: skip


_HEAD = (
    "max error", "simplifier", "vertices", "triangles", "bytes", "max", "rms", "mean", "Hausdorff",
    "seconds", "uncovered",
)  # fmt: skip


def _cells(row: Row) -> list[str]:
    figures = row.figures
    hausdorff = f"{row.hausdorff:.4g}"
    if row.bounds:
        hausdorff = " to ".join(f"{bound:.5g}" for bound in row.bounds)
    return [
        f"{row.max_error:g}",
        label_of(row.name),
        *(_number(count) for count in (figures.n_vertices, figures.n_triangles, figures.n_bytes)),
        *(f"{error:.4g}" for error in (figures.max, figures.rms, figures.mean)),
        hausdorff,
        f"{figures.seconds:.3g}",
        _number(figures.n_uncovered),
    ]


def _drawn(found: Sequence[pictures.Picture]) -> list[str]:
    return [page.picture(picture.png, picture.caption) for picture in found]


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"
