"""The controls of one client of the page, and the lines that tell what it sees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, get_args

import viser

from rtin.viewer.scene import Mode, Picture, Settings

__all__ = ["Panel", "told"]

_MODES = dict(zip(("pixel error", "triangle budget", "tolerance"), get_args(Mode), strict=True))
_MOST_PIXELS, _MOST_TRIANGLES, _MOST_HIGHER = 16.0, 500_000, 10.0
_OF_THE_RANGE = 0.1  # the largest tolerance: of the range of heights
_STEPS = 1000


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
        self._mode: Any = None
        if height_range is not None:
            self._add_levels(settings, height_range)
        with gui.add_folder("Picture"):
            self._add("colours", gui.add_dropdown("Colours", tuple(colours), settings.colours))
            self._add("wireframe", gui.add_checkbox("Wireframe", settings.wireframe))
            higher = gui.add_slider(
                "Exaggeration",
                min(0.1, settings.exaggeration),
                max(_MOST_HIGHER, settings.exaggeration),
                0.1,
                settings.exaggeration,
                hint="Heights, times this",
            )
            self._add("exaggeration", higher)

    @property
    def settings(self) -> Settings:
        """What is chosen now."""
        chosen = {name: control.value for name, control in self._controls.items()}
        mode = self._first.mode if self._mode is None else _MODES[self._mode.value]
        return Settings(**{**vars(self._first), **chosen, "mode": mode})

    def show(self, text: str) -> None:
        """Put a text, in Markdown, above the controls."""
        self._told.content = text

    def _add_levels(self, settings: Settings, height_range: float) -> None:
        """Add the controls of the level of detail; of three sliders one is to be seen."""
        gui = self._gui
        most = _OF_THE_RANGE * height_range or 1.0
        tolerance = most / 20.0 if settings.max_error is None else settings.max_error
        chosen_values = {**vars(settings), "max_error": tolerance}
        with gui.add_folder("Level of detail"):
            chosen = next(name for name, mode in _MODES.items() if mode == settings.mode)
            self._mode = gui.add_dropdown(
                "By", tuple(_MODES), chosen,
                hint="Pixel error and budget follow the camera; a tolerance holds everywhere",
            )  # fmt: skip
            sliders = {
                "pixel_error": ("Pixel error", 0.25, _MOST_PIXELS, 0.25),
                "max_triangles": ("Triangles", 1000, _MOST_TRIANGLES, 1000),
                "max_error": ("Tolerance", 0.0, most, most / _STEPS),
            }
            for name, (label, low, high, step) in sliders.items():
                value = chosen_values[name]
                low, high = min(low, value), max(high, value)
                self._add(name, gui.add_slider(label, low, high, step, value))
        self._mode.on_update(self._choose_mode)
        self._show_the_slider()

    def _add(self, name: str, control: Any) -> None:  # noqa: ANN401  (viser has no common class)
        self._controls[name] = control
        control.on_update(self._changed)

    async def _changed(self, _: object) -> None:
        self._on_change()

    async def _choose_mode(self, _: object) -> None:
        self._show_the_slider()
        self._on_change()

    def _show_the_slider(self) -> None:
        of_modes = dict(zip(get_args(Mode), _SLIDERS, strict=True))
        for name in _SLIDERS:
            self._controls[name].visible = name == of_modes[self.settings.mode]


_SLIDERS = ("pixel_error", "max_triangles", "max_error")


def told(picture: Picture, settings: Settings, frame_seconds: float) -> str:
    """Return the counts of a picture and what it took, in Markdown."""
    counts = f"{picture.n_triangles:,} triangles, {picture.n_vertices:,} vertices".replace(",", " ")
    counts = counts.replace("triangles ", "triangles, ")
    times = f"mesh {1e3 * picture.mesh_seconds:.1f} ms, frame {1e3 * frame_seconds:.0f} ms"
    if picture.kept is None:
        return f"**{counts}**  \n{times}"
    if settings.mode == "tolerance":
        return f"**{counts}**  \nwithin {picture.kept:.4g} in height  \n{times}"
    return f"**{counts}**  \nwithin {picture.kept:.3g} pixels  \n{times}"
