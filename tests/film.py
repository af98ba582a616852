"""What three.js makes of colours, step by step: ACESFilmicToneMapping at an exposure of 1."""

import numpy as np


def filmed(colours):
    """What a screen shows, sRGB in 0..1, of linear colours."""
    red, green, blue = np.moveaxis(np.asarray(colours) / 0.6, -1, 0)
    film = []
    for r, g, b in (
        (0.59719, 0.35458, 0.04823),
        (0.07600, 0.90834, 0.01566),
        (0.02840, 0.13383, 0.83777),
    ):
        v = r * red + g * green + b * blue
        upper = v * (v + 0.0245786) - 0.000090537
        lower = v * (0.983729 * v + 0.4329510) + 0.238081
        film.append(upper / lower)
    shown = [
        1.60475 * film[0] - 0.53108 * film[1] - 0.07367 * film[2],
        -0.10208 * film[0] + 1.10813 * film[1] - 0.00605 * film[2],
        -0.00327 * film[0] - 0.07276 * film[1] + 1.07602 * film[2],
    ]
    linear = np.clip(np.stack(shown, axis=-1), 0.0, 1.0)
    low = linear <= 0.0031308
    return np.where(low, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1.0 / 2.4) - 0.055)


def as_shown(colours):
    """What a page shows, 0..255, of the 16-bit colours or the 8-bit pixels that go to it."""
    colours = np.asarray(colours)
    if colours.dtype == np.uint16:
        linear = colours[..., :3] / 65535.0
    else:
        encoded = colours / 255.0
        low = encoded <= 0.04045
        linear = np.where(low, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return 255.0 * filmed(2.0 * linear)  # the material doubles them
