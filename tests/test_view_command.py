"""What `rtin view` does beside what the page, pictures and openings are tested for."""

from types import SimpleNamespace

import numpy as np
import pytest

import rtin

pytest.importorskip("viser")

from rtin._commands import view
from rtin.viewer.scene import Terrain


class Page:
    """Remembers what it is to show."""

    def __init__(self, terrain):
        self.terrain = terrain
        self.shown = [terrain]

    def replace(self, terrain):
        self.terrain = terrain
        self.shown.append(terrain)


def test_a_stage_that_cannot_be_read_is_told_in_the_terminal_and_on_the_page(capsys):
    first = Terrain(rtin.Grid(np.zeros((5, 5))), note="one in 4; the rest is being read")
    page = Page(first)
    finer = SimpleNamespace(surface=rtin.Grid(np.ones((9, 9))), note="one in 2")

    def go_on(on_opened, on_failure):
        on_opened(finer)
        on_failure(OSError("a.tif cannot be read: it is cut off"))

    view._go_on(SimpleNamespace(go_on=go_on), page, "a.tif", None)
    reason = "the rest of a.tif is not shown: a.tif cannot be read: it is cut off"
    assert [terrain.note for terrain in page.shown] == [first.note, "one in 2", reason]
    assert page.shown[1].place is first.place
    assert page.shown[2].bounds is page.shown[1].bounds
    assert capsys.readouterr().err == f"rtin: {reason}\n"
