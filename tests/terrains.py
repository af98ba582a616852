"""A gallery of awkward terrains, fixed and drawn by hypothesis.

Heights are multiples of 1/16 below 2**12 unless a test is about rounding: planes through them are
exact in float64, so ties are ties in the naive twin and in the kernels alike.
"""

import numpy as np
from affine import Affine
from hypothesis import strategies as st

import naive

SHAPES = [
    (2, 2), (2, 3), (3, 2), (3, 3), (2, 9), (9, 2), (4, 4), (5, 5), (4, 7), (5, 3),
    (6, 9), (9, 9), (9, 17), (10, 10), (13, 6), (17, 17), (17, 23), (16, 16),
]  # fmt: skip


def waves(shape):
    row, col = np.indices(shape)
    return np.round(16 * (40 * np.sin(row / 3.1) * np.cos(col / 4.3) + 2 * row)) / 16


def noise(shape, seed=0):
    return np.random.default_rng(seed).integers(-800, 800, shape) / 16.0


def plateaus(shape):
    row, col = np.indices(shape)
    return 8.0 * ((row // 3 + col // 4) % 3)


def tilted(shape):
    row, col = np.indices(shape)
    return 0.75 * row - 1.25 * col + 100.0


def spike(shape):
    heights = np.zeros(shape)
    heights[shape[0] * 2 // 3, shape[1] // 3] = 50.0
    return heights


def cliff(shape):
    row, col = np.indices(shape)
    return np.where(2 * row > col + 1, 64.0, 0.0)


def staircase(shape):
    return np.floor(waves(shape) / 8)


GALLERY = {
    "waves": waves,
    "noise": noise,
    "plateaus": plateaus,
    "tilted": tilted,
    "spike": spike,
    "cliff": cliff,
    "staircase": staircase,
}


# --- holes: functions of a shape that return True where a sample is void ------------------------


def no_holes(shape):
    return np.zeros(shape, bool)


def pond(shape):
    row, col = np.indices(shape)
    centre = (shape[0] - 1) / 2, (shape[1] - 1) / 2
    return (row - centre[0]) ** 2 + (col - centre[1]) ** 2 < (min(shape) / 4) ** 2


def one_sample(shape):
    holes = no_holes(shape)
    holes[shape[0] // 2, shape[1] // 2] = True
    return holes


def rotated_swath(shape):
    row, col = np.indices(shape)
    return abs(row - col * shape[0] / shape[1]) > min(shape) / 2


def scattered(shape):
    return np.random.default_rng(7).random(shape) < 0.15


def first_corner(shape):
    holes = no_holes(shape)
    holes[0, 0] = True
    return holes


HOLES = {
    "none": no_holes,
    "pond": pond,
    "one sample": one_sample,
    "swath": rotated_swath,
    "scattered": scattered,
    "corner": first_corner,
}


def pierced(heights, holes):
    return np.where(holes, np.nan, heights)


def has_a_triangle(heights):
    """Whether some finest triangle has three heights (else there is no mesh at all)."""
    return bool(naive.finest(heights))


# --- transforms ---------------------------------------------------------------------------------

UTM = Affine.translation(431_207.5, 5_412_993.5)
TRANSFORMS = {
    "north up": Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0),
    "south up": Affine(1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
    "oblong cells": UTM @ Affine.scale(30.0, -10.0),
    "rotated": UTM @ Affine.rotation(33.0) @ Affine.scale(2.0, -2.0),
    "rotated, south up": Affine.translation(-7.25, 46.5) @ Affine.rotation(-120.0),
    "transposed": Affine(0.0, 2.0, 10.0, 3.0, 0.0, 20.0),
}


# --- strategies ---------------------------------------------------------------------------------


@st.composite
def rasters(draw, largest=11, holes=True):
    """Heights of any small shape: smooth, flat, stepped, noisy or all at once; maybe with voids."""
    full = [(side, side) for side in (3, 5, 9, 17) if side <= largest]  # these fill their lattice
    shape = draw(
        st.sampled_from(full) | st.tuples(st.integers(2, largest), st.integers(2, largest))
    )
    steps = draw(st.sampled_from([1, 2, 5, 400]))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    heights = rng.integers(0, steps + 1, shape) / draw(st.sampled_from([1, 16]))
    if draw(st.booleans()):
        heights = heights + draw(st.sampled_from(list(GALLERY.values())))(shape)
    if holes and draw(st.booleans()):
        share = draw(st.sampled_from([0.03, 0.2, 0.5]))
        heights[rng.random(shape) < share] = np.nan
    if not has_a_triangle(heights):
        heights[:2, :2] = 1.0
    return heights


@st.composite
def masks(draw, shape, share=0.1):
    seed = draw(st.integers(0, 2**32 - 1))
    return np.random.default_rng(seed).random(shape) < share


tolerances = st.sampled_from([0.0, 0.0625, 0.5, 1.0, 2.0, 3.5, 10.0, 40.0, 1e6])
