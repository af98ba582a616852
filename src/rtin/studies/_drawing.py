"""What the pictures of all studies share."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtin._atomic import require_place, write_bytes
from rtin.mesh import TriangleMesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["GREY", "INK", "PALE", "draw_mesh", "picture", "require_places", "write_picture"]

INK, GREY, PALE = "#1c2733", "#8a939c", "#c9d3dc"
_DOTS_PER_INCH = 120
_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
}


def require_places(folder: Path, names: Iterable[str]) -> None:
    """Make the folder; raise an OSError now where a picture of these names could not be written."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        require_place(folder / name)


def write_picture(path: Path, size: tuple[float, float], draw: Callable[[Any], None]) -> None:
    """Write what ``draw`` does to a figure of this size in inches, whole or not at all.

    The extension names the format; it must be one that matplotlib knows.
    """
    write_bytes(path, picture(size, draw, path.suffix[1:].lower()))


def picture(
    size: tuple[float, float], draw: Callable[[Any], None], suffix: str = "png"
) -> memoryview:
    """Return what ``draw`` does to a figure of this size in inches; pyplot is not touched."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        drawn = io.BytesIO()
        figure.savefig(drawn, format=suffix, dpi=_DOTS_PER_INCH)
    return _with_a_palette(drawn) if suffix == "png" else drawn.getbuffer()


def _with_a_palette(drawn: io.BytesIO) -> memoryview:
    """Return a PNG in 256 colours: a third of the bytes, and no difference to see."""
    from PIL import Image

    smaller = io.BytesIO()
    Image.open(drawn).convert("RGB").quantize(256).save(smaller, "png", optimize=True)
    return smaller.getbuffer()


def draw_mesh(
    ax: Axes, mesh: TriangleMesh, *, line_width: float, colours: list[str] | None = None
) -> None:
    """Draw a mesh from above, white or each triangle in its colour."""
    from matplotlib.collections import PolyCollection

    outlines: Any = mesh.vertices[mesh.triangles, :2]
    fills = "#ffffff" if colours is None else colours
    ax.add_collection(
        PolyCollection(outlines, facecolors=fills, edgecolors=INK, linewidths=line_width)
    )
    ax.autoscale_view()
    ax.margins(0.01)
    ax.set_aspect("equal")
    ax.set_axis_off()
