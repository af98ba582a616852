"""Colours come out as they are meant."""

import numpy as np
import pytest

from film import as_shown
from rtin import _tint
from rtin.viewer._film import before_film, picture_before_film


def muted(n, seed=0):
    """Colours as terrain has them: none of them quite white, or pure."""
    rng = np.random.default_rng(seed)
    grey = rng.uniform(0.0, 0.9, (n, 1))
    return np.clip(grey + rng.uniform(-0.15, 0.15, (n, 3)) * (1.0 - grey), 0.0, 0.93)


def sent(colours):
    return np.rint(65535.0 * before_film(colours)).astype(np.uint16)


def test_colours_of_terrain_are_shown_as_they_are():
    colours = muted(10_000)
    assert np.abs(as_shown(sent(colours)) - 255.0 * colours).max() < 0.5


@pytest.mark.parametrize("low", [-500.0, 100.0])
def test_every_tint_is_shown_as_it_is_but_for_nearly_white(low):
    tints = _tint.tint(np.linspace(low, 3000.0, 500), low, 3000.0)
    off = np.abs(as_shown(sent(tints)) - 255.0 * tints).max(axis=1)
    assert off[tints.min(axis=1) < 0.93].max() < 0.5
    assert off.max() < 9.0


def test_shades_of_grey_keep_their_order_up_to_white():
    greys = np.linspace(0.0, 1.0, 256)[:, np.newaxis].repeat(3, axis=1)
    shown = as_shown(sent(greys))
    assert (np.diff(shown[:242], axis=0) > 0.0).all()
    assert (np.diff(shown, axis=0) >= 0.0).all()
    assert shown[-1].min() > 240.0


def test_any_colour_can_be_sent():
    corners = np.array(np.meshgrid([0.0, 1.3], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T
    colours = before_film(corners)
    assert np.isfinite(colours).all()
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0


def test_pictures_are_shown_as_they_are():
    picture = np.rint(255.0 * muted(10_000, seed=1)).astype(np.uint8).reshape(100, 100, 3)
    off = np.abs(as_shown(np.asarray(picture_before_film(picture))) - picture)
    assert off.mean() < 0.6
    assert off.max() < 4.0
