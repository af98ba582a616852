"""The pictures of the study of accuracy: figures 5 and 6, and error against vertices."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtin.criteria import vertical_error
from rtin.mesh import TriangleMesh
from rtin.simplifiers import SIMPLIFIERS
from rtin.studies import _drawing
from rtin.studies._drawing import GREY, INK, draw_mesh, write_picture
from rtin.studies.accuracy import FIGURE_5, TABLE_1, Close, Study, rows_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PICTURES", "require_places", "write_figure_5", "write_pictures"]

_COLOURS = {"threshold": "#b5532a", "rtin": "#2f6f9f", "angle-merge": "#6b7f2a"}
_FIGURE_6 = {"angle-merge": "angle merging", "threshold": "RTIN-Coarsening"}


def require_places(folder: Path) -> None:
    """Make the folder; raise an OSError now where a picture could not be written."""
    _drawing.require_places(folder, [*PICTURES, "figure-5.png"])


def write_pictures(study: Study, folder: str | os.PathLike[str]) -> list[Path]:
    """Write figure 6 and error against vertices to a folder; return their paths."""
    written = []
    for name, (size, draw) in PICTURES.items():
        path = Path(folder) / name
        write_picture(path, size, partial(draw, study=study))
        written.append(path)
    return written


def write_figure_5(close: Close, folder: str | os.PathLike[str]) -> Path:
    """Write figure 5 to a folder; return its path."""
    path = Path(folder) / "figure-5.png"
    write_picture(path, (9.0, 4.2), partial(_draw_figure_5, close=close))
    return path


def _draw_figure_5(figure: Figure, close: Close) -> None:
    mesh = close.at_count.mesh
    plan = figure.add_subplot(1, 2, 1)
    draw_mesh(plan, mesh, line_width=0.4)
    error = vertical_error(mesh, close.grid).max
    plan.set_title(
        f"(a) {mesh.n_vertices} vertices, {mesh.n_triangles} triangles at threshold "
        f"{close.at_count.setting:.3g};\nlargest error {error:.3g}"
    )
    view: Any = figure.add_subplot(1, 2, 2, projection="3d")
    x, y, z = mesh.vertices.T
    view.plot_trisurf(x, y, z, triangles=mesh.triangles, cmap="gist_earth", ec=INK, lw=0.15)
    view.set_box_aspect(np.ptp(mesh.vertices, axis=0) * [1.0, 1.0, 2.0], zoom=1.3)
    view.view_init(elev=35.0, azim=-60.0)
    view.set_axis_off()
    view.set_title(
        f"(b) in perspective, heights doubled; at the paper's threshold,\n"
        f"{FIGURE_5['threshold']:g}, it has {close.at_threshold.n_vertices} vertices"
    )


def _draw_figure_6(figure: Figure, study: Study) -> None:
    axes = figure.subplots(len(TABLE_1), len(_FIGURE_6), squeeze=False)
    for column, (name, label) in zip(axes.T, _FIGURE_6.items(), strict=True):
        for ax in column:
            ax.set_axis_off()
        for ax, row in zip(column, rows_of(study, name), strict=False):
            _draw_row(ax, row.made.mesh)
            figures = row.figures
            ax.set_title(
                f"{label}: {figures.n_vertices} vertices, errors up to {figures.max:.3g}",
                fontsize=8.0,
            )


def _draw_row(ax: Any, mesh: TriangleMesh) -> None:  # noqa: ANN401
    draw_mesh(ax, mesh, line_width=0.15 if mesh.n_triangles > 5000 else 0.3)


def _draw_errors(figure: Figure, study: Study) -> None:
    axes = figure.subplots(1, 2)
    names = list(dict.fromkeys(row.figures.name for row in study.rows))
    for ax, key in zip(axes, ("rms", "max"), strict=True):
        for name in names:
            rows = rows_of(study, name)
            ax.plot(
                [row.figures.n_vertices for row in rows],
                [getattr(row.metro, key) / study.relief for row in rows],
                "o-", ms=3.5, lw=1.3, color=_COLOURS.get(name), label=SIMPLIFIERS[name].label,
            )  # fmt: skip
        ax.plot(
            [row.n_vertices for row in TABLE_1],
            [getattr(row.metro, key) for row in TABLE_1],
            "x--", ms=4.0, lw=0.8, color=GREY, label="the paper's Table 1, as printed",
        )  # fmt: skip
        ax.set(xscale="log", yscale="log", xlabel="vertices", ylabel=f"{key} / relief")
        ax.set_title(f"distance from the terrain to the mesh, {key}")
    axes[0].legend(loc="lower left")


_Draw = Callable[..., None]

# name: size in inches, and what draws it
PICTURES: dict[str, tuple[tuple[float, float], _Draw]] = {
    "figure-6.png": ((7.0, 10.2), _draw_figure_6),
    "errors.png": ((9.0, 3.8), _draw_errors),
}
