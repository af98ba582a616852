"""Colours that come out as they are meant where a page's camera has a film of its own.

viser leaves three.js's tone mapping on (``ACESFilmicToneMapping``: Stephen Hill's fit of the
Academy Color Encoding System), which darkens shades, bleaches colours and turns white into light
grey. So colours go through its inverse before.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rtin import _tint

if TYPE_CHECKING:
    from PIL import Image, ImageFilter

__all__ = ["BRIGHTNESS", "before_film", "picture_before_film"]

BRIGHTNESS = 2.0  # what a material multiplies with: with 15 white would be white, and shades coarse
_EXPOSURE = 1.0 / 0.6
_INTO_FILM = np.array(
    [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]]
)
_OUT_OF_FILM = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]]
)
# Of the curve: (v (v + A) - B) / (v (C v + D) + E).
_A, _B, _C, _D, _E = 0.0245786, 0.000090537, 0.983729, 0.4329510, 0.238081
_STEPS = 33  # of the table for pictures, along each colour

_Floats = NDArray[np.float64]


def before_film(colours: _Floats) -> _Floats:
    """Return linear colours in 0..1, shape (n, 3), which ``BRIGHTNESS`` times and filmed are those.

    ``colours`` are sRGB, 1 where they are more. What the film never shows, nearly white or pure,
    comes out paler.
    """
    wanted = np.linalg.solve(_OUT_OF_FILM, _tint.linear(colours.clip(0.0, 1.0)).T)
    # A quadratic in v; its other root is negative.
    a, b, c = 1.0 - _C * wanted, _A - _D * wanted, -_B - _E * wanted
    exposed = (np.sqrt(b * b - 4.0 * a * c) - b) / (2.0 * a)
    linear = np.linalg.solve(_INTO_FILM, exposed).T / _EXPOSURE
    return np.clip(linear / BRIGHTNESS, 0.0, 1.0)


def picture_before_film(image: NDArray[np.uint8]) -> Image.Image:
    """Return what ``before_film`` makes of an sRGB picture, shape (rows, cols, 3), in sRGB, too."""
    from PIL import Image

    return Image.fromarray(image).filter(_table())


@cache
def _table() -> ImageFilter.Color3DLUT:
    from PIL import ImageFilter

    steps = np.linspace(0.0, 1.0, _STEPS)
    blue, green, red = np.meshgrid(steps, steps, steps, indexing="ij")
    colours = before_film(np.column_stack([red.ravel(), green.ravel(), blue.ravel()]))
    return ImageFilter.Color3DLUT(_STEPS, _tint.encoded(colours).ravel().tolist())
