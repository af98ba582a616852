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
from rtin.lod import as_point, frustum
from rtin.mesh import TriangleMesh
from rtin.viewer._from_above import sampled
from rtin.viewer.scene import SIDE, Place, Terrain, View

__all__ = ["flight", "is_in_sight", "orbit", "overlook", "seen_from"]

_Floats = NDArray[np.float64]
_LOOP = 0.34 * SIDE  # half the width of the figure of eight of a flight
_DOWNWARDS = math.radians(40.0)  # where a first view looks
_FILLED = 0.9  # of a picture
_UPRIGHT = 1e-6  # across by down: less is straight down
_CLEARANCE = 0.035 * SIDE
_AHEAD = 0.06  # of a flight: where it looks
_SAMPLES_OF_A_MESH = 1 << 20
_SMOOTHED = 0.02  # of a flight: over how much of it climbs and descents are spread


def overlook(
    terrain: Terrain | None = None, exaggeration: float = 1.0, aspect: float = 16.0 / 9.0
) -> View:
    """Return the view from the south, down on a terrain, from as near as all of it is seen.

    Its bounds fill nine tenths of a picture of that aspect, across or upright. Without a
    terrain they are those of a flat square.
    """
    west, south, low, east, north, high = _box(terrain, exaggeration).ravel()
    corners = np.array(
        [(x, y, z) for x in (west, east) for y in (south, north) for z in (low, high)]
    )
    return _framing(corners, aspect)


def seen_from(place: Place, eye: ArrayLike, target: ArrayLike, exaggeration: float = 1.0) -> View:
    """Return the view from one point of the world to another, both x, y, z.

    Heights are up in the picture; y is, where it looks straight down or up. Raises ValueError where
    a point is not three finite numbers, or both are one.
    """
    eye, target = as_point("eye", eye), as_point("target", target)
    if np.array_equal(eye, target):
        raise ValueError(f"eye and target must be two points, both are {eye.tolist()}")
    points = place.into_scene(np.array([eye, target]), exaggeration)
    across, deep = np.hypot(*(points[1] - points[0])[:2]), abs(points[1, 2] - points[0, 2])
    up = (0.0, 1.0, 0.0) if across < _UPRIGHT * deep else View.up
    first, last = points.tolist()
    return View(tuple(first), tuple(last), up)


def is_in_sight(
    terrain: Terrain, view: View, exaggeration: float = 1.0, aspect: float = 16.0 / 9.0
) -> bool:
    """Return whether a terrain's bounds reach into a view; False where it sees nothing of it."""
    planes = frustum(
        view.eye, view.target, field_of_view=view.field_of_view, aspect=aspect, up=view.up
    )
    low, high = _box(terrain, exaggeration)
    nearest = np.where(planes[:, :3] > 0.0, high, low)  # to the inside of each plane
    return bool((np.sum(planes[:, :3] * nearest, axis=1) + planes[:, 3] >= 0.0).all())


def orbit(
    n: int, terrain: Terrain | None = None, exaggeration: float = 1.0, aspect: float = 16.0 / 9.0
) -> list[View]:
    """Return n views of a round about a terrain, all of which see it as ``overlook`` does.

    The first one is from the south, the next ones from further east. Raises TypeError or ValueError
    where n is no whole number from 1 on.
    """
    angles = 2.0 * math.pi * np.arange(_as_number_of_views(n)) / n
    box = _box(terrain, exaggeration)
    radius = np.linalg.norm(np.ptp(box, axis=0)[:2]) / 2.0
    rim = np.linspace(0.0, 2.0 * math.pi, 64, endpoint=False)
    around = radius * np.column_stack([np.cos(rim), np.sin(rim)])
    points = [np.column_stack([around, np.full(len(rim), z)]) for z in box[:, 2]]
    first = _framing(np.concatenate(points), aspect)
    return [View(_turned(first.eye, angle), _turned(first.target, angle)) for angle in angles]


def flight(
    surface: Grid | TriangleMesh, place: Place, n: int, exaggeration: float = 1.0
) -> list[View]:
    """Return n views of a flight over a terrain: a figure of eight that follows the ground.

    The path is closed, and ``0.035 * SIDE`` or more above the ground along it, but for a spike
    between two of the 2000 places where that is looked at. Raises TypeError or ValueError where n
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


def _box(terrain: Terrain | None, exaggeration: float) -> _Floats:
    """Return least and largest x, y, z of a terrain in the scene."""
    if terrain is None:
        return SIDE / 2.0 * np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
    return terrain.place.into_scene(terrain.bounds, exaggeration)


def _framing(points: _Floats, aspect: float) -> View:
    """Return the nearest view from the south whose picture has all points, as many above as below.

    A point that lies ``up`` and ``away`` of the target is below the picture's upper edge where
    up - shift <= tangent (distance + away). So the least distance is that of one point, and with
    the lower edge the same, half the sum of two; that for the sides may be larger.
    """
    forward = np.array([0.0, math.cos(_DOWNWARDS), -math.sin(_DOWNWARDS)])
    upward = np.array([0.0, math.sin(_DOWNWARDS), math.cos(_DOWNWARDS)])
    tangent = _FILLED * math.tan(math.radians(View.field_of_view) / 2.0)
    across, up, away = points[:, 0], points @ upward, points @ forward
    upright = (np.max(up - tangent * away) + np.max(-up - tangent * away)) / (2.0 * tangent)
    distance = max(upright, np.max(np.abs(across) / (tangent * aspect) - away))
    target = _middle(up, distance + away) * upward
    return View(tuple((target - distance * forward).tolist()), tuple(target.tolist()))


def _middle(up: _Floats, depths: _Floats) -> float:
    """Return the shift upwards with which points reach as far up as down in a picture."""
    low, high = float(up.min()), float(up.max())
    for _ in range(60):
        shift = (low + high) / 2.0
        seen = (up - shift) / depths
        low, high = (shift, high) if seen.max() > -seen.min() else (low, shift)
    return shift


def _turned(point: tuple[float, ...], angle: float) -> tuple[float, ...]:
    """Return a point turned about the middle of the scene, counter-clockwise from above."""
    x, y, z = point
    cos, sin = math.cos(angle), math.sin(angle)
    return x * cos - y * sin, x * sin + y * cos, z


def _eight(turns: _Floats) -> _Floats:
    """Return x and y of a figure of eight (Gerono's lemniscate), which begins in its middle."""
    angle = 2.0 * np.pi * turns
    return _LOOP * np.column_stack([np.sin(angle), np.sin(angle) * np.cos(angle)])


def _ground(
    surface: Grid | TriangleMesh, place: Place, points: _Floats, exaggeration: float
) -> _Floats:
    """Return how high the terrain is drawn below points; the lowest there is where it has none."""
    if isinstance(surface, TriangleMesh):
        surface = sampled(surface, _SAMPLES_OF_A_MESH)
    world = place.into_world(np.column_stack([points, np.zeros(len(points))]))
    heights = surface.heights_at(world[:, :2])
    world[:, 2] = np.where(np.isnan(heights), np.nanmin(surface.heights), heights)
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
