"""The controls of a client, on a GUI that only remembers them."""

import asyncio
from types import SimpleNamespace

import pytest

pytest.importorskip("viser")

from contextlib import nullcontext

from rtin.viewer._panel import Panel, told, told_failure
from rtin.viewer.scene import MOST_TRIANGLES, Picture, Settings


class Control(SimpleNamespace):
    """What viser's handles have in common."""

    def on_update(self, call):
        self.call = call

    def choose(self, value):
        self.value = value
        asyncio.run(self.call(None))


class Gui:
    """As much of viser's as a panel needs; it remembers controls by their labels."""

    def __init__(self):
        self.controls = {}

    def add_markdown(self, content):
        return SimpleNamespace(content=content)

    def add_folder(self, label):
        return nullcontext()

    def _add(self, label, initial_value, **options):
        self.controls[label] = Control(value=initial_value, visible=True, **options)
        return self.controls[label]

    def add_dropdown(self, label, options, *, initial_value, **more):
        return self._add(label, initial_value, options=options, **more)

    def add_checkbox(self, label, *, initial_value):
        return self._add(label, initial_value)

    def add_slider(self, label, *, min, max, step, initial_value):  # noqa: A002
        assert min <= initial_value <= max  # as viser asks for
        return self._add(label, initial_value, min=min, max=max, step=step)


def panel(settings=None, height_range=200.0, colours=("hillshade", "height"), calls=None):
    gui = Gui()
    calls = [] if calls is None else calls
    made = Panel(
        gui,
        settings or Settings(),
        height_range=height_range,
        colours=colours,
        on_change=lambda: calls.append(made.settings),
    )
    return made, gui.controls


def sliders(controls):
    return {name for name in ("Pixel error", "Triangles", "Tolerance") if controls[name].visible}


@pytest.mark.parametrize(
    ("label", "typed", "name", "least"),
    [("Pixel error", -5.0, "pixel_error", 0.25), ("Triangles", 0, "max_triangles", 1000),
     ("Tolerance", -1.0, "max_error", 0.0), ("Exaggeration", 0.0, "exaggeration", 0.1)],
)  # fmt: skip
def test_what_is_typed_below_a_slider_is_its_least(label, typed, name, least):
    made, controls = panel()
    controls[label].choose(typed)
    assert getattr(made.settings, name) == least


def test_only_the_slider_that_counts_is_seen():
    calls = []
    _, controls = panel(calls=calls)
    assert sliders(controls) == {"Pixel error"}
    for mode, label in (("tolerance", "Tolerance"), ("triangle budget", "Triangles")):
        controls["By"].choose(mode)
        assert sliders(controls) == {label}
    assert [settings.mode for settings in calls] == ["tolerance", "triangle budget"]


def test_what_is_chosen_is_what_is_drawn():
    made, controls = panel()
    controls["Pixel error"].choose(3.0)
    controls["Colours"].choose("height")
    controls["Wireframe"].choose(True)
    controls["Exaggeration"].choose(2.0)
    assert made.settings == Settings(
        pixel_error=3.0, colours="height", wireframe=True, exaggeration=2.0, max_error=1.0
    )


@pytest.mark.parametrize(
    ("label", "settings", "value"),
    [
        ("Pixel error", Settings(pixel_error=40.0), 40.0),
        ("Pixel error", Settings(pixel_error=0.01), 0.01),
        ("Triangles", Settings("triangle budget", max_triangles=12), 12),
        ("Triangles", Settings("triangle budget", max_triangles=10**7), 10**7),
        ("Tolerance", Settings("tolerance", max_error=900.0), 900.0),
        ("Exaggeration", Settings(exaggeration=50.0), 50.0),
    ],
)
def test_sliders_reach_as_far_as_what_was_asked_for(label, settings, value):
    _, controls = panel(settings)
    assert controls[label].value == value


def test_sliders_reach_as_far_as_usual():
    _, controls = panel()
    assert (controls["Triangles"].min, controls["Triangles"].max) == (1000, MOST_TRIANGLES)
    assert controls["Tolerance"].max == pytest.approx(20.0)
    _, controls = panel(height_range=0.0)
    assert controls["Tolerance"].max == 1.0


def test_the_tolerance_goes_as_far_as_another_terrain_wants():
    made, controls = panel()
    made.reach(1000.0)
    assert controls["Tolerance"].max == pytest.approx(100.0)
    controls["Tolerance"].choose(90.0)
    made.reach(200.0)
    assert (controls["Tolerance"].value, controls["Tolerance"].max) == (90.0, 90.0)


def test_a_mesh_has_no_level_of_detail_to_choose():
    made, controls = panel(height_range=None)
    assert set(controls) == {"Colours", "Wireframe", "Exaggeration"}
    made.reach(5.0)
    controls["Wireframe"].choose(True)
    assert made.settings == Settings(wireframe=True)


@pytest.mark.parametrize(("wanted", "first"), [("height", "height"), ("error", "hillshade")])
def test_colours_that_there_are_not_are_the_first_ones(wanted, first):
    made, _ = panel(Settings(colours=wanted))
    assert made.settings.colours == first


def test_counts_tolerance_times_and_note_are_told():
    picture = Picture(b"", 12_345, 678, 2.5, False, 0.0041, 0.02)
    text = told(picture, Settings(), 0.06, "all 9 × 9 samples")
    assert text.splitlines() == [
        "**12 345 triangles**, 678 vertices  ",
        "pixel error 2.5  ",
        "mesh 4.1 ms, frame 60 ms  ",
        "all 9 × 9 samples",
    ]
    assert told(picture, Settings(), 0.06, "my_own_dem.tif").endswith(r"my\_own\_dem.tif")
    assert "within 2.5 in height" in told(picture, Settings("tolerance"), 0.06)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ValueError("too\nmany"), "**too many**"),
        (MemoryError(), "**MemoryError**"),
        (OSError("a_b*.tif <c>"), r"**a\_b\*.tif \<c>**"),
    ],
)
def test_what_failed_is_told_in_a_line(error, text):
    assert told_failure(error) == text
