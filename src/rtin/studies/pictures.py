"""The pictures of the study of propagation."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rtin.conformity import propagation
from rtin.mesh import TriangleMesh
from rtin.studies import _drawing
from rtin.studies._drawing import GREY, INK, PALE, draw_mesh, write_picture
from rtin.studies.propagation import (
    PAPER,
    PLACES,
    Evolution,
    Study,
    growing_strip,
    refine_at,
    touched_by,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PICTURES", "require_places", "write_pictures"]

_COLOURS = {"M1": "#b5532a", "M2": "#2f6f9f"}
_DRAWN_STEPS = 5  # of refining at a corner: smaller triangles could not be seen
_DRAWN_PART = 0.251  # of the unit square's sides
_DRAWN_STRIP = 14  # triangles


def require_places(folder: Path) -> None:
    """Make the folder; raise an OSError now where ``write_pictures`` would."""
    _drawing.require_places(folder, PICTURES)


def write_pictures(study: Study, folder: str | os.PathLike[str]) -> list[Path]:
    """Write the pictures of a study to a folder; return their paths.

    What takes ``long`` to measure is drawn if it was measured. Each file is written whole or not
    at all.
    """
    written = []
    for name, (size, draw) in PICTURES.items():
        if draw is _draw_long_runs and study.long is None:
            continue
        path = Path(folder) / name
        write_picture(path, size, partial(draw, study=study))
        written.append(path)
    return written


# --- figure 3 -----------------------------------------------------------------------------------


def _draw_figure_3(figure: Figure, study: Study) -> None:
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.25])
    mesh = study.one_run.mesh
    draw_mesh(left, mesh, line_width=0.4)
    n_splits = int(study.runs.splits[-1])
    left.set_title(f"(a) {mesh.n_triangles:,} triangles after {n_splits} splits")
    runs = study.runs
    for name, ours, one, paper in [
        ("M1", runs.m1, study.one_run.m1[0], PAPER["refined"].m1),
        ("M2", runs.m2, study.one_run.m2[0], PAPER["refined"].m2),
    ]:
        colour, mean = _COLOURS[name], ours.mean(axis=0)
        if len(ours) > 1:
            spread = ours.std(axis=0, ddof=1)
            label = f"{name}, {len(ours)} seeds: mean ± spread"
            right.fill_between(
                runs.splits, mean - spread, mean + spread, color=colour, alpha=0.2, lw=0.0
            )
            right.plot(runs.splits, mean, color=colour, lw=1.6, label=label)
        right.plot(study.one_run.splits, one, color=colour, lw=0.6, label=f"{name}, mesh of (a)")
        right.axhline(paper, color=INK, lw=0.8, ls=(0, (5, 3)))
        right.annotate(
            f"the paper's {name} = {paper}", (1.0, paper), xycoords=("axes fraction", "data"),
            xytext=(0, -3), textcoords="offset points", ha="right", va="top", fontsize=8.0,
        )  # fmt: skip
    right.set(xlim=(0, n_splits), ylim=(0, 9), xlabel="refinements", ylabel="mean over the mesh")
    right.set_title("(b) M1 and M2 as the mesh is refined")
    right.legend(loc="lower right", ncols=2, bbox_to_anchor=(1.0, 0.0))


# --- histograms ---------------------------------------------------------------------------------


def _draw_histograms(figure: Figure, study: Study) -> None:
    from matplotlib.ticker import MaxNLocator

    axes = figure.subplots(1, 2)
    n_splits, n_points = int(study.runs.splits[-1]), study.tins.mesh.n_vertices
    for ax, name in zip(axes, ("M1", "M2"), strict=True):
        counts = [getattr(run, f"{name.lower()}_counts") for run in (study.runs, study.tins)]
        labels = [f"RTIN after {n_splits} splits", f"Delaunay, {n_points:,} points"]
        for shift, colour, label, count in zip(
            (-0.2, 0.2), (_COLOURS[name], PALE), labels, counts, strict=True
        ):
            values, shares = np.arange(len(count)), 100.0 * count / count.sum()
            mean = float(values @ shares) / 100.0
            label = f"{label}: mean {mean:.2f}, largest {len(count) - 1}"
            ax.bar(values + shift, shares, 0.4, color=colour, label=label)
        shown = np.flatnonzero(max(counts, key=_tail) > 0.001 * max(counts, key=_tail).sum())
        ax.set(xlim=(-0.7, shown[-1] + 0.7), xlabel=name, ylabel="% of the triangles")
        ax.set_title(f"{name} of single triangles")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.set_ylim(0.0, 1.25 * ax.get_ylim()[1])
        ax.legend(loc="upper right")


def _tail(count: NDArray[np.int64]) -> int:
    """Return the largest value that one triangle in a thousand has, or more of them."""
    return int(np.flatnonzero(count > 0.001 * count.sum())[-1])


# --- worst cases --------------------------------------------------------------------------------


def _draw_worst_cases(figure: Figure, study: Study) -> None:
    grid = figure.add_gridspec(2, 2, width_ratios=[1.1, 1.0], height_ratios=[3.0, 1.0])
    _draw_steps(figure.add_subplot(grid[:, 0]), study)
    ax = figure.add_subplot(grid[0, 1])
    mesh = refine_at(PLACES["corner"], _DRAWN_STEPS).mesh
    n_touched = _draw_touched(ax, mesh)
    ax.set(xlim=(-0.001, _DRAWN_PART), ylim=(-0.001, _DRAWN_PART))
    ax.set_title(
        f"refined {_DRAWN_STEPS - 1} times at a corner: refining\n"
        f"the dark triangle would split {n_touched} more"
    )
    ax = figure.add_subplot(grid[1, 1])
    strip = growing_strip(_DRAWN_STRIP)
    n_touched = _draw_touched(ax, strip, 0)
    ax.set_title(f"edges grow to the right:\nthe dark triangle takes all {n_touched} others along")


def _draw_steps(ax: Axes, study: Study) -> None:
    markers = {"corner": ("o", 8.0), "border": ("s", 5.0), "centre": (".", 4.0)}
    for name, worst in study.worst.items():
        steps = np.arange(1, len(worst.largest_m2) + 1)
        marker, size = markers[name]
        ax.plot(
            steps, worst.largest_m2, marker, ms=size, mfc="none", color=_COLOURS["M2"],
            label=f"largest M2 in the mesh, {name}",
        )  # fmt: skip
    ax.plot(steps, 2 * steps, color=_COLOURS["M2"], lw=0.8, zorder=0)
    ax.annotate(
        "2 · step", (0.45 * len(steps), 0.95 * len(steps)), xytext=(-6, 6), ha="right",
        textcoords="offset points", color=_COLOURS["M2"],
    )  # fmt: skip
    for name, worst in study.worst.items():
        style = {"corner": "-", "border": "--", "centre": ":"}[name]
        ax.plot(steps, worst.target_m1, style, color=_COLOURS["M1"], lw=1.4,
                label=f"M1 of the triangle refined, {name}")  # fmt: skip
    ax.set(xlim=(0.5, len(steps) + 0.5), ylim=(0, None), xlabel="step", ylabel="triangles")
    ax.set_title("refining again and again at one place")
    ax.legend(loc="upper left")


def _draw_touched(ax: Axes, mesh: TriangleMesh, target: int | None = None) -> int:
    """Draw a mesh, a target (else one of the largest M2), and the others it splits: how many."""
    if target is None:
        target = int(np.argmax(propagation(mesh).m2))
    touched = touched_by(mesh, target)
    colours = ["#ffffff"] * mesh.n_triangles
    for triangle in touched:
        colours[triangle] = "#a9cbe3"
    colours[target] = _COLOURS["M2"]
    draw_mesh(ax, mesh, line_width=0.5, colours=colours)
    return len(touched) - 1


# --- long runs ----------------------------------------------------------------------------------


def _draw_long_runs(figure: Figure, study: Study) -> None:
    assert study.long is not None
    axes = figure.subplots(1, 2)
    long = study.long
    for ax, name in zip(axes, ("M1", "M2"), strict=True):
        key, colour = name.lower(), _COLOURS[name]
        _draw_band(ax, long.rtin, key, colour, f"uniform mesh, {len(long.rtin.m1)} seeds")
        _draw_band(
            ax, long.tin, key, GREY, f"Delaunay mesh of 1000 points, {len(long.tin.m1)} seeds"
        )
        last = getattr(long.longest, key)[:, -1]
        ax.plot([long.longest.splits[-1]], [last.mean()], "o", ms=4.0, color=colour,
                label=f"uniform mesh, {len(last)} seeds: {last.mean():.3f}")  # fmt: skip
        paper = getattr(PAPER["refined"], key)
        ax.axhline(paper, color=INK, lw=0.8, ls=(0, (5, 3)), label=f"the paper's {paper}")
        ax.set(xscale="log", xlabel="refinements", ylabel=f"mean {name} over the mesh")
        ax.legend(loc="lower right")


def _draw_band(ax: Axes, run: Evolution, key: str, colour: str, label: str) -> None:
    values = getattr(run, key)
    later = run.splits > 0
    mean, spread = values.mean(axis=0)[later], values.std(axis=0, ddof=1)[later]
    splits = run.splits[later]
    ax.fill_between(splits, mean - spread, mean + spread, color=colour, alpha=0.2, lw=0.0)
    ax.plot(splits, mean, color=colour, lw=1.4, label=label)


_Draw = Callable[..., None]

# name: size in inches, and what draws it
PICTURES: dict[str, tuple[tuple[float, float], _Draw]] = {
    "figure-3.png": ((9.0, 4.0), _draw_figure_3),
    "histograms.png": ((9.0, 3.4), _draw_histograms),
    "worst-cases.png": ((9.0, 4.6), _draw_worst_cases),
    "long-runs.png": ((9.0, 3.6), _draw_long_runs),
}
