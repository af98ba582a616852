"""How near coarsened meshes are to their terrain: Tables 1 to 3 and figures 5 and 6 of the paper.

Suárez and Plaza, "Four-triangles adaptive algorithms for RTIN terrain meshes", coarsen 257² samples
of Gran Canaria at thresholds of 30, 60 and 90 m to 5750, 1975 and 1094 vertices, let Rational
Reducer, a commercial program, make meshes of about as many, measure both with Metro and conclude
that theirs are more accurate. Their raster is not public, nor is Rational Reducer: here another
terrain stands in for the one, and ``rtin.simplifiers``' "angle-merge", which does what the paper
says of it, for the other. So what is repeated is the comparison at the paper's numbers of vertices,
and not its figures.

Metro's figures are those of ``rtin.compare``, from the terrain to the mesh, by subdivision
sampling. The paper does not name their unit. Parts of the terrain's relief, the unit used here
beside them, fit its numbers of vertices; kilometres would fit its thresholds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtin import samples
from rtin._raster import moved
from rtin.coarsening import coarsen
from rtin.distance import compare
from rtin.grid import Grid
from rtin.mesh import TriangleMesh
from rtin.simplifiers import (
    SIMPLIFIERS,
    Compared,
    NotInstalled,
    NotSuited,
    Simplified,
    compared,
    simplified,
)

__all__ = [
    "BY_DEFAULT",
    "FIGURE_5",
    "SECONDS",
    "TABLE_1",
    "TABLE_2",
    "THRESHOLDS",
    "Close",
    "Metro",
    "Published",
    "Row",
    "Study",
    "as_text",
    "close_up",
    "measure",
    "names_with",
    "rows_of",
    "times_as_text",
    "verdict",
]

Stage = Callable[[str], AbstractContextManager[None]]


class Metro(NamedTuple):
    """Metro's figures of a mesh: from the terrain to it, but for the Hausdorff distance."""

    rms: float
    max: float
    mean: float
    hausdorff: float


class Published(NamedTuple):
    """A row of the paper's Table 1 or 2; its unit is not given."""

    label: str
    n_vertices: int
    metro: Metro


TABLE_1 = (
    Published("RTIN-30", 5750, Metro(0.006734, 0.048659, 0.003678, 0.048659)),
    Published("RTIN-60", 1975, Metro(0.011615, 0.088699, 0.006760, 0.127386)),
    Published("RTIN-90", 1094, Metro(0.018781, 0.124696, 0.011200, 0.173783)),
)
TABLE_2 = (
    Published("RR-91.38%", 5741, Metro(0.489856, 0.906838, 0.421390, 0.906838)),
    Published("RR-97.11%", 1978, Metro(0.251238, 0.586906, 0.221660, 0.906827)),
    Published("RR-98.45%", 1079, Metro(0.250870, 0.581874, 0.221626, 0.906798)),
)
# Table 3: of RTIN-Coarsening and of Rational Reducer, on an Athlon of 2.2 GHz.
SECONDS = {"threshold": (5.312, 2.232, 1.443), "angle-merge": (1.289, 2.150, 4.203)}
THRESHOLDS = (30.0, 60.0, 90.0)  # metres, of Table 1
FIGURE_5 = {"threshold": 15.0, "n_samples": 4225, "n_vertices": 1588, "n_triangles": 3063}

# The paper's two, and the least mesh.
BY_DEFAULT = ("threshold", "rtin", "angle-merge")
_TABLES = {"threshold": TABLE_1, "angle-merge": TABLE_2}
_N_SAMPLES = 257 * 257  # of the paper's terrain
_SIDE = 65  # samples, of figure 5


@dataclass(frozen=True, eq=False)
class Row:
    """One mesh of the comparison; lengths in the unit of the heights.

    Attributes
    ----------
    asked : int
        The number of vertices asked for.
    made : Simplified
    figures : Compared
        Vertical errors, counts, seconds.
    metro : Metro
    """

    asked: int
    made: Simplified
    figures: Compared
    metro: Metro

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name, nothing nested but Metro's."""
        return {
            "asked": self.asked,
            **self.figures._asdict(),
            self.made.knob: self.made.setting,
            "metro": self.metro._asdict(),
        }


@dataclass(frozen=True, eq=False)
class Close:
    """Figure 5: a small terrain, coarsened by the threshold and to the vertices of the paper."""

    grid: Grid
    at_threshold: TriangleMesh
    at_count: Simplified


@dataclass(frozen=True, eq=False)
class Study:
    """All that is measured.

    Attributes
    ----------
    grid : Grid
        The terrain, in metres.
    relief : float
        Its highest sample above its lowest.
    spread : float
        The standard deviation of the heights: the vertical RMS of a flat plane.
    rows : list of Row
        For each number of vertices, each simplifier.
    at_thresholds : dict of float to int
        Vertices at the paper's thresholds.
    notes : list of str
        Simplifiers passed over, and why.
    """

    grid: Grid
    relief: float
    spread: float
    rows: list[Row]
    at_thresholds: dict[float, int]
    notes: list[str]


# --- terrains -----------------------------------------------------------------------------------


def _jacksboro() -> Grid:
    """Return 257² samples of matplotlib's DEM, the size of the paper's."""
    grid = samples.jacksboro_fault()
    return Grid(grid.heights[:257, :257], grid.transform, grid.crs)


def _steepest_part(grid: Grid) -> Grid:
    """Return the 65² samples, of those side by side from the corner on, with the most relief."""
    rows, cols = grid.shape
    corners = [
        (row, col)
        for row in range(0, max(1, rows - _SIDE + 1), _SIDE - 1)
        for col in range(0, max(1, cols - _SIDE + 1), _SIDE - 1)
    ]
    parts = [(grid.heights[row : row + _SIDE, col : col + _SIDE], row, col) for row, col in corners]
    heights, row, col = max(parts, key=lambda part: _relief(part[0]))
    return Grid(heights, moved(grid.transform, row, col), grid.crs)


def _relief(heights: NDArray[np.floating[Any]]) -> float:
    valid = heights[~np.isnan(heights)]
    return float(valid.max() - valid.min()) if valid.size else -1.0


# --- experiments --------------------------------------------------------------------------------


def names_with(others: str) -> list[str]:
    """Return the names of the simplifiers to compare by default, and others, apart by commas.

    Raises ValueError for one that is unknown.
    """
    names = list(BY_DEFAULT)
    for name in filter(None, map(str.strip, others.split(","))):
        if name not in SIMPLIFIERS:
            raise ValueError(f"a simplifier is one of {', '.join(SIMPLIFIERS)}, got {name!r}")
        names += [name] * (name not in names)
    return names


def measure(
    grid: Grid | None = None,
    names: Sequence[str] = BY_DEFAULT,
    *,
    stage: Stage | None = None,
) -> Study:
    """Return meshes of a terrain by each simplifier at the paper's numbers of vertices, measured.

    Parameters
    ----------
    grid : Grid, optional
        Jacksboro by default. Degrees become metres. Of 257² samples 5750, 1975 and 1094 vertices
        are wanted, of more or fewer samples the same shares.
    names : sequence of str
        Of ``rtin.simplifiers.SIMPLIFIERS``.
    stage : callable, optional
        Gets the name of what begins, and returns a context in which it is done.

    Raises
    ------
    ValueError
        If a terrain has no relief or too few samples.
    """
    terrain = (_jacksboro() if grid is None else grid).in_metres()
    relief = _relief(terrain.heights)
    if relief == 0.0:
        raise ValueError("a terrain with some relief is wanted, got one height everywhere")
    counts = [round(row.n_vertices * terrain.n_samples / _N_SAMPLES) for row in TABLE_1]
    if min(counts) < 4:
        raise ValueError(f"a terrain of 242 samples or more is wanted, got {terrain.n_samples}")
    rows, notes = _compare_all(terrain, counts, names, stage or (lambda _: nullcontext()))
    return Study(
        grid=terrain,
        relief=relief,
        spread=float(np.nanstd(terrain.heights, dtype=np.float64)),
        rows=rows,
        at_thresholds={t: coarsen(terrain, threshold=t).n_vertices for t in THRESHOLDS},
        notes=notes,
    )


def _compare_all(
    terrain: Grid, counts: list[int], names: Sequence[str], stage: Stage
) -> tuple[list[Row], list[str]]:
    rows, notes = [], []
    for count in counts:
        for name in names:
            with stage(f"{SIMPLIFIERS[name].label} to {count} vertices"):
                try:
                    made = simplified(terrain, name, max_vertices=count)
                except (NotInstalled, NotSuited) as reason:
                    notes.append(f"{name}, {count} vertices: {reason}")
                    continue
                figures = compared(terrain, name, made)
                rows.append(Row(count, made, figures, _metro(terrain, made.mesh)))
    return rows, notes


def _metro(terrain: Grid, mesh: TriangleMesh) -> Metro:
    found = compare(terrain, mesh)
    there = found.forward
    return Metro(there.rms, there.max, there.mean, found.hausdorff)


def close_up(grid: Grid | None = None) -> Close:
    """Return figure 5: the steepest 65² samples of a terrain, coarsened."""
    part = _steepest_part((_jacksboro() if grid is None else grid).in_metres())
    count = round(FIGURE_5["n_vertices"] * part.n_samples / FIGURE_5["n_samples"])
    return Close(
        grid=part,
        at_threshold=coarsen(part, threshold=FIGURE_5["threshold"]),
        at_count=simplified(part, "threshold", max_vertices=max(4, count)),
    )


# --- tables -------------------------------------------------------------------------------------


def rows_of(study: Study, name: str) -> list[Row]:
    """Return the rows of one simplifier, the most vertices first."""
    return [row for row in study.rows if row.figures.name == name]


def as_text(study: Study) -> str:
    """Return Tables 1 and 2 for people: the paper's figures, and ours in parts of the relief."""
    names = list(dict.fromkeys(row.figures.name for row in study.rows))
    width = max(len(SIMPLIFIERS[name].label) for name in names) + 18 if names else 30
    lines = [f"{'':{width}}  vertices      RMS      max     mean  Hausdorff  largest vertical"]
    for name in names:
        for published in _TABLES.get(name, ()):
            label = f"the paper's {published.label}"
            lines.append(f"{label:{width}}  {_figures(published.n_vertices, published.metro)}")
        for row in rows_of(study, name):
            parts = Metro(*(value / study.relief for value in row.metro))
            label = f"{SIMPLIFIERS[name].label}, {_setting(row.made)}"
            vertical = f"{row.figures.max:16.4g}"
            figures = _figures(row.figures.n_vertices, parts)
            lines.append(f"{label:{width}}  {figures}  {vertical}")
    return "\n".join([*lines, "", *_remarks(study)])


def _figures(n_vertices: int, metro: Metro) -> str:
    rms, largest, mean, hausdorff = metro
    return f"{n_vertices:8d}  {rms:.5f}  {largest:.5f}  {mean:.5f}    {hausdorff:.5f}"


def _setting(made: Simplified) -> str:
    if made.knob == "tolerance":
        return f"threshold {made.setting:.4g}"
    return f"≤ {int(made.setting)} {made.knob.removeprefix('max_')}"


def _remarks(study: Study) -> list[str]:
    at = ", ".join(f"{n} at {t:g}" for t, n in study.at_thresholds.items())
    found = [row.made.setting for row in rows_of(study, "threshold")]
    needed = ", ".join(f"{setting:.4g}" for setting in found)
    wanted = ", ".join(f"{t:g}" for t in THRESHOLDS)
    return [
        f"Ours: in parts of the relief, {study.relief:.5g}; the last column in its unit. The "
        "paper's: as printed.",
        f"Vertices at the paper's thresholds: {at}.",
        *([f"Thresholds for the paper's vertices: {needed}, not {wanted}."] if found else []),
        f"A flat plane at the mean height would have an RMS of {study.spread / study.relief:.3f}, "
        "and at most 0.5 on any terrain.",
        *verdict(study),
        *study.notes,
    ]


def verdict(study: Study) -> list[str]:
    """Return a line a number of vertices: how much farther off angle merging is than thresholding.

    Empty where one of them was not measured. The paper's claim is that all these are above one.
    """
    lines, holds = [], []
    for ours in rows_of(study, "threshold"):
        for theirs in rows_of(study, "angle-merge"):
            if theirs.asked == ours.asked:
                ratios = [b / a for a, b in zip(ours.metro, theirs.metro, strict=True)]
                holds += [ratio > 1.0 for ratio in ratios]
                rms, largest, mean, hausdorff = ratios
                lines.append(
                    f"Angle merging to {theirs.asked} vertices: RMS {rms:.2f} ×, max {largest:.2f} "
                    f"×, mean {mean:.2f} ×, Hausdorff {hausdorff:.2f} × that of RTIN-Coarsening."
                )
    if holds:
        claim = "holds" if all(holds) else f"holds in {sum(holds)} of {len(holds)} figures"
        lines.append(f"That RTIN-Coarsening is the more accurate {claim} on this terrain.")
        by_paper = ", ".join(
            f"{rr.metro.rms / rtin.metro.rms:.0f} ×"
            for rr, rtin in zip(TABLE_2, TABLE_1, strict=True)
        )
        lines.append(f"In the paper Rational Reducer's RMS is {by_paper} that of RTIN-Coarsening.")
    return lines


def times_as_text(study: Study) -> str:
    """Return Table 3 for people: seconds, the paper's beside ours."""
    lines = [f"{'':24}  {'vertices':>8}  {'paper, s':>8}  {'ours, s':>9}"]
    for name in dict.fromkeys(row.figures.name for row in study.rows):
        published = SECONDS.get(name, (None,) * len(TABLE_1))
        for paper, row in zip(published, rows_of(study, name), strict=False):
            theirs = "" if paper is None else f"{paper:.3f}"
            lines.append(
                f"{SIMPLIFIERS[name].label:24}  {row.figures.n_vertices:8d}  {theirs:>8}  "
                f"{row.figures.seconds:9.5f}"
            )
    return "\n".join(lines)
