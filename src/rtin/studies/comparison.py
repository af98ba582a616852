"""What ``rtin compare`` measures: two surfaces, or a raster's simplified meshes side by side."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from rtin._pairs import Progress
from rtin._surfaces import bounds_of, local_system, surface_of
from rtin.coarsening import coarsen
from rtin.criteria import VerticalError, vertical_error
from rtin.distance import (
    CertifiedDistance,
    OneSided,
    Sampling,
    SurfaceDistance,
    compare,
    hausdorff,
)
from rtin.grid import Grid
from rtin.mesh import TriangleMesh
from rtin.overlay import TerrainDifference, terrain_difference
from rtin.simplifiers import (
    SIMPLIFIERS,
    Compared,
    NotInstalled,
    Simplified,
    compared,
    simplified,
)

__all__ = [
    "OURS",
    "VARIANTS",
    "Comparison",
    "Match",
    "Method",
    "Pair",
    "Row",
    "as_text",
    "known_names",
    "label_of",
    "measure",
    "measure_pair",
    "names_in",
    "pair_as_text",
    "sides_as_dicts",
    "tolerances_in",
]

Surface = TriangleMesh | Grid
Match = Literal["vertices", "error"]
Stage = Callable[[str], AbstractContextManager[Progress | None]]

OURS = "rtin"  # the least mesh, which sets how many vertices the others get


class Variant(NamedTuple):
    """Other options of ``coarsen``, to be compared like a simplifier."""

    label: str
    options: dict[str, Any]


VARIANTS = {
    "rms": Variant("RTIN of least RMS", {"norm": "rms"}),
    "best": Variant("RTIN, best diagonals", {"diagonals": "best"}),
    "fitted": Variant("RTIN, fitted heights", {"heights": "fitted"}),
}


class Method(NamedTuple):
    """How distances are measured.

    Attributes
    ----------
    sampling, samples, seed
        As for ``rtin.compare``.
    certified : bool
        Whether to bound the Hausdorff distance too.
    tolerance : float or None
        As for ``rtin.hausdorff``.
    """

    sampling: Sampling = "subdivision"
    samples: int | None = None
    seed: int = 0
    certified: bool = False
    tolerance: float | None = None


# --- two surfaces -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Pair:
    """Two surfaces, measured; lengths in the unit of the heights.

    Attributes
    ----------
    a, b : TriangleMesh or Grid
    distance : SurfaceDistance
    certified : CertifiedDistance or None
    vertical : VerticalError or None
        Of the mesh against the raster, where one side is a mesh and the other a raster, and the
        mesh covers a sample of it.
    difference : TerrainDifference or None
        B less A at the same places, where both have some in common.
    notes : list of str
        What to know of the coordinates.
    """

    a: Surface
    b: Surface
    distance: SurfaceDistance
    certified: CertifiedDistance | None
    vertical: VerticalError | None
    difference: TerrainDifference | None
    notes: list[str]

    def counts(self) -> list[dict[str, int]]:
        """Return the numbers of vertices and triangles of both sides."""
        return [_counts(surface) for surface in (self.a, self.b)]


def measure_pair(
    a: Surface, b: Surface, method: Method | None = None, *, stage: Stage | None = None
) -> Pair:
    """Return how far two surfaces are from each other.

    Raises
    ------
    TypeError, ValueError
        As ``rtin.compare`` and ``rtin.hausdorff`` do.
    """
    stage = stage or _no_stage
    found = _distances(a, b, method or Method(), stage)
    with stage("measuring upright"):
        vertical = _vertical(a, b)
    with stage("overlaying") as tell:
        difference = _difference(a, b, tell)
    return Pair(a, b, *found, vertical, difference, _notes_on(a, b))


def _no_stage(_: str) -> AbstractContextManager[None]:
    return nullcontext()


def _distances(
    a: Surface, b: Surface, method: Method, stage: Stage
) -> tuple[SurfaceDistance, CertifiedDistance | None]:
    sampling, samples, seed, certified, tolerance = method
    with stage("measuring distances") as tell:
        found = compare(a, b, sampling, samples=samples, seed=seed, progress=tell)
    if not certified:
        return found, None
    with stage("bounding the Hausdorff distance") as tell:
        return found, hausdorff(a, b, tolerance=tolerance, progress=tell)


def _vertical(a: Surface, b: Surface) -> VerticalError | None:
    mesh, grid = (b, a) if isinstance(a, Grid) else (a, b)
    if not isinstance(mesh, TriangleMesh) or not isinstance(grid, Grid):
        return None
    try:
        return vertical_error(mesh, grid)
    except ValueError:  # it covers no sample
        return None


def _difference(a: Surface, b: Surface, tell: Progress | None) -> TerrainDifference | None:
    try:
        return terrain_difference(a, b, progress=tell)
    except ValueError:  # they have no place in common
        return None


def _counts(surface: Surface) -> dict[str, int]:
    if isinstance(surface, TriangleMesh):
        return {"vertices": surface.n_vertices, "triangles": surface.n_triangles}
    n_triangles = surface_of(surface, local_system(surface)).n_triangles
    return {"vertices": surface.n_samples, "triangles": n_triangles}


def _notes_on(a: Surface, b: Surface) -> list[str]:
    notes = []
    names = {"A": a.crs, "B": b.crs}
    without = [name for name, crs in names.items() if crs is None]
    if len(without) == 1:
        notes.append(f"{without[0]} has no CRS: taken to be in the other's coordinates")
    if any(crs is not None and crs.is_geographic for crs in names.values()):
        notes.append("degrees: x and y were scaled to metres about the middle of both surfaces")
    boxes = [bounds_of(surface) for surface in (a, b)]
    if (boxes[0][0] > boxes[1][1]).any() or (boxes[1][0] > boxes[0][1]).any():
        notes.append("the surfaces do not overlap: are both in the same coordinates?")
    return notes


# --- one raster's simplified meshes -------------------------------------------------------------


class Row(NamedTuple):
    """A simplified mesh, measured; lengths in the unit of the heights.

    Attributes
    ----------
    max_error : float
        The tolerance of this part of the table.
    figures : Compared
        Counts, bytes, vertical errors, seconds.
    hausdorff : float
        From samples: never more than the Hausdorff distance.
    bounds : (float, float) or None
        Of the Hausdorff distance, where they were asked for.
    mesh : TriangleMesh
    """

    max_error: float
    figures: Compared
    hausdorff: float
    bounds: tuple[float, float] | None
    mesh: TriangleMesh

    @property
    def name(self) -> str:
        """The simplifier's name."""
        return self.figures.name

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name, nothing nested but the faults."""
        figures = self.figures
        lower, upper = self.bounds or (None, None)
        return {
            "max_error": self.max_error,
            "name": figures.name,
            "label": label_of(figures.name),
            "vertices": figures.n_vertices,
            "triangles": figures.n_triangles,
            "bytes": figures.n_bytes,
            "max": figures.max,
            "rms": figures.rms,
            "mean": figures.mean,
            "hausdorff": self.hausdorff,
            "hausdorff_lower": lower,
            "hausdorff_upper": upper,
            "seconds": round(figures.seconds, 6),
            "uncovered_samples": figures.n_uncovered,
            "faults": list(figures.faults),
        }


@dataclass(frozen=True, eq=False)
class Comparison:
    """Simplified meshes of a raster.

    Attributes
    ----------
    grid : Grid
    match : "vertices" or "error"
    rows : list of Row
        For each tolerance the least mesh, then the others in the order of their names.
    notes : list of str
        Who was passed over and why, and what is wrong with meshes.
    """

    grid: Grid
    match: Match
    rows: list[Row]
    notes: list[str]

    def tolerances(self) -> list[float]:
        """Return the tolerances, in order."""
        return list(dict.fromkeys(row.max_error for row in self.rows))

    def names(self) -> list[str]:
        """Return the names of those that made a mesh, in order."""
        made = {row.name for row in self.rows}
        return [name for name in (OURS, *known_names()) if name in made]

    def rows_at(self, max_error: float) -> list[Row]:
        """Return the rows of a tolerance."""
        return [row for row in self.rows if row.max_error == max_error]


def known_names() -> list[str]:
    """Return all that the least mesh can be compared with."""
    return [*VARIANTS, *(name for name in SIMPLIFIERS if name != OURS)]


def label_of(name: str) -> str:
    """Return the name of a simplifier for people."""
    return VARIANTS[name].label if name in VARIANTS else SIMPLIFIERS[name].label


def names_in(text: str) -> list[str]:
    """Return the names in a list with commas, each once; "all" stands for all of them.

    Raises
    ------
    ValueError
        If one is unknown.
    """
    known, names = known_names(), []
    for name in filter(None, map(str.strip, text.split(","))):
        if name not in (*known, OURS, "all"):
            raise ValueError(f"a simplifier is one of {', '.join(known)} or all, got {name!r}")
        names += known if name == "all" else [name] * (name != OURS)
    return list(dict.fromkeys(names))


def tolerances_in(text: str) -> list[float]:
    """Return the numbers in a list with commas, each once, the smallest first.

    Raises
    ------
    ValueError
        If there is none, or one is no finite number from zero on.
    """
    try:
        found = {float(part) for part in text.split(",")}
    except ValueError:
        found = {-1.0}
    if not all(0.0 <= value < float("inf") for value in found):
        raise ValueError(f"heights from zero on, apart by commas, are wanted, got {text!r}")
    return sorted(found)


def measure(
    grid: Grid,
    tolerances: Sequence[float],
    names: Sequence[str] = (),
    *,
    match: Match = "vertices",
    method: Method | None = None,
    stage: Stage | None = None,
) -> Comparison:
    """Return the least mesh for each tolerance, and what others make of the same, measured.

    Parameters
    ----------
    grid : Grid
    tolerances : sequence of float
        Largest vertical errors, in the unit of the heights.
    names : sequence of str
        Of ``known_names()``.
    match : {"vertices", "error"}
        Whether the others get as many vertices as the least mesh has, at most, or its tolerance.
    method : Method, optional
    stage : callable, optional
        Gets the name of what begins, and returns a context in which it is done. That context
        gives None, or a function to be told the share that is done.

    Raises
    ------
    TypeError, ValueError
        As ``coarsen`` and ``compare`` do. A simplifier that is not installed, or can't do what is
        asked with this grid, is passed over with a note.
    """
    stage, rows = stage or _no_stage, []
    passed_over: dict[tuple[str, str], list[float]] = {}
    for max_error in tolerances:
        asked: dict[str, Any] = {"max_error": max_error}
        for name in (OURS, *names):
            with stage(f"{label_of(name)} for {max_error:g}"):
                made = _attempt(grid, name, asked)
            if isinstance(made, str):
                passed_over.setdefault((name, made), []).append(max_error)
                continue
            mesh, figures = made
            distance, certified = _distances(grid, mesh, method or Method(), stage)
            bounds = None if certified is None else (certified.lower, certified.upper)
            rows.append(Row(max_error, figures, distance.hausdorff, bounds, mesh))
            if name == OURS and match == "vertices":
                asked = {"max_vertices": mesh.n_vertices}
    notes = [
        f"{name} for {', '.join(f'{value:g}' for value in at)}: {reason}"
        for (name, reason), at in passed_over.items()
    ]
    return Comparison(grid, match, rows, [*notes, *_complaints_about(rows)])


def _attempt(grid: Grid, name: str, asked: dict[str, Any]) -> tuple[TriangleMesh, Compared] | str:
    """Return what a simplifier makes and how good it is, or why it can't."""
    try:
        made = _made(grid, name, asked)
        return made.mesh, compared(grid, name, made)
    except NotInstalled as reason:
        return str(reason)
    except ValueError as reason:  # NotSuited, or a mesh that covers no sample
        if name == OURS:
            raise
        return str(reason)


def _made(grid: Grid, name: str, asked: dict[str, Any]) -> Simplified:
    if name not in VARIANTS:
        return simplified(grid, name, **asked)
    options = VARIANTS[name].options
    knob, setting = next(iter(asked.items()))
    small: dict[str, Any] = {knob: {"max_error": 1.0, "max_vertices": 30}[knob]}
    rough = Grid((np.arange(81) ** 2 % 7).reshape(9, 9).astype(grid.heights.dtype))
    coarsen(rough, **small, **options)  # compiling is none of the work
    started = time.perf_counter()
    mesh = coarsen(grid, **asked, **options)
    return Simplified(mesh, knob, setting, time.perf_counter() - started)


def _complaints_about(rows: Sequence[Row]) -> Iterator[str]:
    for name in dict.fromkeys(row.name for row in rows):
        figures = [(row.max_error, row.figures) for row in rows if row.name == name]
        uncovered = [f"{one.n_uncovered} for {at:g}" for at, one in figures if one.n_uncovered]
        if uncovered:
            yield f"{name} leaves samples uncovered, which enter no figure: {', '.join(uncovered)}"
        faulty = [(at, one.faults) for at, one in figures if one.faults]
        if faulty:
            at = ", ".join(f"{value:g}" for value, _ in faulty)
            yield f"{name} makes no conforming mesh for {at}; the first fault: {faulty[0][1][0]}"


# --- tables -------------------------------------------------------------------------------------

_SHARES = {"median": 0.5, "quantile_90": 0.9, "quantile_99": 0.99}


def sides_as_dicts(distance: SurfaceDistance) -> dict[str, dict[str, Any]]:
    """Return the figures of both directions by name; the place is a list of x, y and z."""
    return {"forward": _side(distance.forward), "backward": _side(distance.backward)}


def _side(side: OneSided) -> dict[str, Any]:
    return {
        "samples": side.n_samples,
        "max": side.max,
        "rms": side.rms,
        "mean": side.mean,
        "area_rms": side.area_rms,
        "area_mean": side.area_mean,
        **{name: side.quantile(share) for name, share in _SHARES.items()},
        "place": list(side.place),
    }


def pair_as_text(pair: Pair) -> str:
    """Return the figures of both directions for people."""
    there, back = sides_as_dicts(pair.distance).values()
    lines = [f"{'distance':>18}  {'A to B':>12}  {'B to A':>12}"]
    for name, value in there.items():
        if name != "place":
            digits = 12 if name == "samples" else 6
            figures = f"{value:12.{digits}g}  {back[name]:12.{digits}g}"
            lines.append(f"{name.replace('_', ' '):>18}  {figures}")
    for number, axis in enumerate("xyz"):
        values = (side["place"][number] for side in (there, back))
        lines.append(f"{'largest at ' + axis:>18}  " + "  ".join(f"{v:12.10g}" for v in values))
    return "\n".join(lines)


def as_text(comparison: Comparison) -> str:
    """Return the table for people, a part for each tolerance."""
    width = max(len(label_of(name)) for name in comparison.names())
    certified = any(row.bounds for row in comparison.rows)
    head = (
        f"{'max error':>9}  {'':{width}}  {'vertices':>9} {'triangles':>9} {'bytes':>10} "
        f"{'max':>9} {'rms':>9} {'mean':>9} {'Hausdorff':>{21 if certified else 9}} {'seconds':>8}"
    )
    lines = [head]
    for max_error in comparison.tolerances():
        lines += [_line(row, width) for row in comparison.rows_at(max_error)] + [""]
    return "\n".join(lines[:-1])


def _line(row: Row, width: int) -> str:
    figures = row.figures
    hausdorff = f"{row.hausdorff:9.4g}"
    if row.bounds:
        hausdorff = f"{' to '.join(f'{bound:.5g}' for bound in row.bounds):>21}"
    return (
        f"{row.max_error:9g}  {label_of(row.name):{width}}  {figures.n_vertices:9d} "
        f"{figures.n_triangles:9d} {figures.n_bytes:10d} {figures.max:9.4g} {figures.rms:9.4g} "
        f"{figures.mean:9.4g} {hausdorff} {figures.seconds:8.4f}"
    )
