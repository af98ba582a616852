"""The controls of one client of the page, and the lines that tell what it sees."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, get_args

import viser

from rtin.viewer.scene import MOST_TRIANGLES, Mode, Picture, Settings

__all__ = ["Panel", "told", "told_failure"]

_CHOSEN_BY = {
    "pixel error": "pixel_error",
    "triangle budget": "max_triangles",
    "tolerance": "max_error",
}
_SLIDERS = (*_CHOSEN_BY.values(), "exaggeration")
_MOST_PIXELS, _MOST_HIGHER = 16.0, 10.0
_OF_THE_RANGE = 0.1  # of heights: the largest tolerance
_FIRST_OF_THAT = 0.05
_STEPS = 1000
_MARKS = re.compile(r"[\\`*_<\[\]]")  # of Markdown, as they stand in paths and names


class Panel:
    """The controls in a client's browser.

    Parameters
    ----------
    gui : viser.GuiApi
        Of the client.
    settings : Settings
        What is chosen at first.
    height_range : float, or None for a terrain without level of detail
        Between the lowest and the highest point: how far the slider of the tolerance goes.
    colours : sequence of str
        Names to choose from.
    on_change : function
        Called in the server's event loop when something else has been chosen.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        settings: Settings,
        *,
        height_range: float | None,
        colours: Sequence[str],
        on_change: Callable[[], None],
    ) -> None:
        self._gui = gui
        self._on_change = on_change
        self._first = settings
        self._controls: dict[str, Any] = {}
        self._told = gui.add_markdown("…")
        if height_range is not None:
            with gui.add_folder("Level of detail"):
                self._add_levels(settings, height_range)
        with gui.add_folder("Picture"):
            first = settings.colours if settings.colours in colours else colours[0]
            names = gui.add_dropdown("Colours", tuple(colours), initial_value=first)
            self._add("colours", names)
            edges = gui.add_checkbox("Wireframe", initial_value=settings.wireframe)
            self._add("wireframe", edges)
            self._add_slider(
                "exaggeration", "Exaggeration", settings.exaggeration, 0.1, _MOST_HIGHER, 0.1
            )

    @property
    def settings(self) -> Settings:
        """What is chosen now: at least the least of a slider, whatever is typed beside it."""
        chosen = {
            name: max(control.value, control.min) if name in _SLIDERS else control.value
            for name, control in self._controls.items()
        }
        return Settings(**{**vars(self._first), **chosen})

    def show(self, text: str) -> None:
        """Put a text, in Markdown, above the controls."""
        self._told.content = text

    def reach(self, height_range: float) -> None:
        """Have the slider of the tolerance go as far as another terrain wants.

        What is chosen stays chosen, so the slider ends there at the least.
        """
        if "max_error" in self._controls:
            slider = self._controls["max_error"]
            slider.max = max(_largest_tolerance(height_range), slider.value)
            slider.step = slider.max / _STEPS

    def _add_levels(self, settings: Settings, height_range: float) -> None:
        """Add the mode, and three sliders of which one is to be seen."""
        most = _largest_tolerance(height_range)
        tolerance = _FIRST_OF_THAT * most if settings.max_error is None else settings.max_error
        mode = self._gui.add_dropdown(
            "By",
            get_args(Mode),
            initial_value=settings.mode,
            hint="Pixel error and budget follow the camera; a tolerance holds everywhere.",
        )
        self._add("mode", mode)
        self._add_slider(
            "pixel_error", "Pixel error", settings.pixel_error, 0.25, _MOST_PIXELS, 0.25
        )
        self._add_slider(
            "max_triangles", "Triangles", settings.max_triangles, 1000, MOST_TRIANGLES, 1000
        )
        self._add_slider("max_error", "Tolerance", tolerance, 0.0, most, most / _STEPS)
        self._show_the_slider()

    def _add_slider(
        self, name: str, label: str, value: float, low: float, high: float, step: float
    ) -> None:
        """Add a slider from ``low`` to ``high``, or as far as the first value wants."""
        low, high = min(low, value), max(high, value)
        slider = self._gui.add_slider(label, min=low, max=high, step=step, initial_value=value)
        self._add(name, slider)

    def _add(self, name: str, control: Any) -> None:  # noqa: ANN401  (viser has no common class)
        self._controls[name] = control
        control.on_update(self._changed)

    async def _changed(self, _: object) -> None:
        if "mode" in self._controls:
            self._show_the_slider()
        self._on_change()

    def _show_the_slider(self) -> None:
        for mode, name in _CHOSEN_BY.items():
            self._controls[name].visible = mode == self._controls["mode"].value


def _largest_tolerance(height_range: float) -> float:
    return _OF_THE_RANGE * height_range or 1.0


def told(picture: Picture, settings: Settings, frame_seconds: float, note: str = "") -> str:
    """Return the counts of a picture, what it took, and a note, in Markdown."""
    lines = [
        f"**{_spaced(picture.n_triangles)} triangles**, {_spaced(picture.n_vertices)} vertices"
    ]
    if picture.is_cut_short:
        lines.append("as many as the page draws")
    if picture.kept is not None:
        kept = f"{picture.kept:.3g}"
        is_height = settings.mode == "tolerance"
        lines.append(f"within {kept} in height" if is_height else f"pixel error {kept}")
    times = f"mesh {1e3 * picture.mesh_seconds:.1f} ms, frame {1e3 * frame_seconds:.0f} ms"
    return "  \n".join([*lines, times, *filter(None, [_as_it_stands(note)])])


def told_failure(error: Exception) -> str:
    """Return what went wrong, in bold Markdown; an error without a message has a name at least."""
    message = " ".join(str(error).split()) or type(error).__name__
    return f"**{_as_it_stands(message)}**"


def _as_it_stands(text: str) -> str:
    """Return Markdown for a text that has none."""
    return _MARKS.sub(r"\\\g<0>", text)


def _spaced(number: int) -> str:
    return f"{number:,}".replace(",", " ")
