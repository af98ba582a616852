"""Where to look at a terrain from: a first view, and paths for films.

All in the scene of ``rtin.viewer.scene``, where the longer side of a terrain has ``SIDE`` units
and its middle is at the origin.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin._options import as_count
from rtin.grid import Grid
from rtin.mesh import TriangleMesh
from rtin.viewer.scene import SIDE, Place, View, bounds_of

__all__ = ["flight", "orbit", "overlook", "seen_from"]

_Floats = NDArray[np.float64]
_LOOP = 0.34 * SIDE  # half the width of the figure of eight of a flight
_CLEARANCE = 0.035 * SIDE
_AHEAD = 0.06  # of a flight: where it looks
_SMOOTHED = 0.02  # of a flight: over how much of it climbs and descents are spread


def overlook() -> View:
    """Return the view from the south, above the whole terrain."""
    return View((0.0, -0.75 * SIDE, 0.55 * SIDE), (0.0, -0.05 * SIDE, 0.0))


def seen_from(place: Place, eye: ArrayLike, target: ArrayLike, exaggeration: float = 1.0) -> View:
    """Return the view from one point of the world to another, both x, y, z."""
    points = place.into_scene(np.array([eye, target], np.float64), exaggeration).tolist()
    return View(tuple(points[0]), tuple(points[1]))


def orbit(n: int) -> list[View]:
    """Return n views of a round about the terrain, all of them from as high as ``overlook``.

    Raises TypeError or ValueError where n is no whole number from 1 on.
    """
    _, south, height = overlook().eye
    angles = 2.0 * math.pi * np.arange(_as_number_of_views(n)) / n - math.pi / 2.0
    return [
        View((-south * math.cos(angle), -south * math.sin(angle), height), (0.0, 0.0, 0.0))
        for angle in angles.tolist()
    ]


def flight(
    surface: Grid | TriangleMesh, place: Place, n: int, exaggeration: float = 1.0
) -> list[View]:
    """Return n views of a flight over a terrain: a figure of eight that follows the ground.

    The path is closed, and never lower than ``0.035 * SIDE`` above the ground below it; above the
    highest point of a mesh, which has no ground to follow. Raises TypeError or ValueError where n
    is no whole number from 1 on.
    """
    turns = np.arange(_as_number_of_views(n)) / n
    many = np.linspace(0.0, 1.0, 2000, endpoint=False)
    ground = _smoothed(_ground(surface, place, _eight(many), exaggeration))
    heights = np.interp(turns, many, ground, period=1.0) + _CLEARANCE
    looks = np.interp((turns + _AHEAD) % 1.0, many, ground, period=1.0)
    eyes = np.column_stack([_eight(turns), heights]).tolist()
    targets = np.column_stack([_eight(turns + _AHEAD), looks]).tolist()
    return [View(tuple(eye), tuple(target)) for eye, target in zip(eyes, targets, strict=True)]


def _eight(turns: _Floats) -> _Floats:
    """Return x and y of a figure of eight (Gerono's lemniscate), which begins in its middle."""
    angle = 2.0 * np.pi * turns
    return _LOOP * np.column_stack([np.sin(angle), np.sin(angle) * np.cos(angle)])


def _ground(
    surface: Grid | TriangleMesh, place: Place, points: _Floats, exaggeration: float
) -> _Floats:
    """Return how high the terrain is drawn below points; the lowest there is where it has none."""
    lowest, highest = bounds_of(surface)[:, 2].tolist()
    world = place.into_world(np.column_stack([points, np.zeros(len(points))]))
    world[:, 2] = highest
    if isinstance(surface, Grid):
        heights = surface.heights_at(world[:, :2])
        world[:, 2] = np.where(np.isnan(heights), lowest, heights)
    return place.into_scene(world, exaggeration)[:, 2]


def _smoothed(heights: _Floats) -> _Floats:
    """Return the highest ground nearby, in a curve without steps."""
    reach = max(1, round(_SMOOTHED * len(heights)))
    highest = np.max(
        [np.roll(heights, shift) for shift in range(-2 * reach, 2 * reach + 1)], axis=0
    )
    window = np.hanning(2 * reach + 1)
    wrapped = np.concatenate([highest[-reach:], highest, highest[:reach]])
    return np.convolve(wrapped, window / window.sum(), "valid")


def _as_number_of_views(n: int) -> int:
    if as_count("n", n) < 1:
        raise ValueError(f"n must be at least one view, got {n}")
    return n
