"""Differences of terrains at the same places, exact by overlay rather than sampled.

Where a triangle of one terrain lies above or below one of the other, their difference in height is
linear over the convex polygon that both share, seen from above: its extremes are at the polygon's
corners, and its integral and that of its square have closed forms, as have those of what is above
and below zero (cut and fill). Normals and slopes are constant over it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtin import _parallel
from rtin._pairs import Progress, Steps, shares_of, two_surfaces
from rtin._surfaces import Local, Surface
from rtin.grid import Grid
from rtin.mesh import TriangleMesh

__all__ = ["Angles", "TerrainDifference", "terrain_difference"]

_Floats = NDArray[np.float64]

_ROUNDING = 1e-12  # of the extent: what is this near to an edge lies on it


class Angles(NamedTuple):
    """Angles in degrees over the area in common.

    Attributes
    ----------
    mean, rms : float
        Weighted by the area seen from above.
    max : float
        The largest, whatever its sign.
    """

    mean: float
    rms: float
    max: float


@dataclass(frozen=True, repr=False)
class TerrainDifference:
    """The second terrain less the first one, over the area that both cover.

    Heights are in their own unit, areas in the square of the unit of x and y (metres where the CRS
    is geographic), volumes in the product of both.

    Attributes
    ----------
    max, min, mean, mean_abs, rms : float
        Of the difference of heights: how much higher the second terrain is; ``mean_abs`` is the
        mean of its absolute value. Means are weighted by area.
    place_of_max, place_of_min : (float, float)
        x and y of a place with the largest and the smallest difference, in the unit of the CRS.
    fill, cut : float
        Volume between the terrains where the second one is higher, and where it is lower: what has
        to be brought, and taken away, to make the second terrain of the first one.
    area : float
        That both terrains cover, seen from above.
    area_only_a, area_only_b : float
        That only the first, or only the second terrain covers.
    normals : Angles
        Between the upward normals of both terrains.
    slope : Angles
        How much steeper the second terrain is; the mean may be negative.
    """

    max: float
    min: float
    mean: float
    mean_abs: float
    rms: float
    place_of_max: tuple[float, float]
    place_of_min: tuple[float, float]
    fill: float
    cut: float
    area: float
    area_only_a: float
    area_only_b: float
    normals: Angles
    slope: Angles

    @property
    def net(self) -> float:
        """The volume filled less the volume cut."""
        return self.fill - self.cut

    def __repr__(self) -> str:
        return (
            f"<TerrainDifference {self.min:.6g} to {self.max:.6g}, mean {self.mean:.6g}, "
            f"rms {self.rms:.6g}; fill {self.fill:.6g}, cut {self.cut:.6g} over {self.area:.6g}; "
            f"normals {self.normals.mean:.4g}° apart>"
        )


def terrain_difference(
    mesh_a: TriangleMesh | Grid,
    mesh_b: TriangleMesh | Grid,
    *,
    progress: Progress | None = None,
) -> TerrainDifference:
    """Return how much higher the second terrain is than the first one, at the same places.

    Nothing is sampled: all figures are those of the piecewise linear surfaces, up to the rounding
    of float64.

    Parameters
    ----------
    mesh_a, mesh_b : TriangleMesh or Grid
        A grid stands for its finest triangles. Triangles without an area seen from above count for
        nothing, which way round the others run does not matter. Where a mesh overlaps itself, its
        area is counted as often as it covers a place, and that of the other is never less than
        none.
    progress : callable, optional
        Gets the share that is done, from 0 to 1, now and then.

    Returns
    -------
    TerrainDifference
        The same bytes on any number of threads.

    Raises
    ------
    TypeError
        If a terrain is neither a TriangleMesh nor a Grid.
    ValueError
        If a terrain has no triangle or a vertex that is not finite, the terrains have unlike CRS,
        are larger than 1e50, or have no area in common.
    """
    local, a, b = two_surfaces(mesh_a, mesh_b)
    is_turned = _rank(mesh_a, a) > _rank(mesh_b, b)
    source, target = (b, a) if is_turned else (a, b)
    found = _differences(source, target, _width_of_edges(local), Steps(progress, source.n_pieces))
    if not found.area > 0.0:
        raise ValueError(
            "terrains must have an area in common, seen from above, got two that lie apart"
        )
    areas = _area_from_above(a), _area_from_above(b)
    return _result(found.turned() if is_turned else found, areas, local)


def _rank(terrain: TriangleMesh | Grid, surface: Surface) -> tuple[bool, int]:
    """Return a key: the one with the smaller is walked over, the other one looked up.

    Cells of a grid are the quickest to look up, and those of small triangles quicker than those of
    large ones. Turning both round does not change a digit unless they have equally many triangles.
    """
    return isinstance(terrain, Grid), surface.n_triangles


def _width_of_edges(local: Local) -> float:
    """Return how far places may be off by rounding, in the local system."""
    of_places = np.spacing(np.abs(local.origin)) * local.scale
    return float(_ROUNDING * local.extent + 4.0 * of_places.max())


# --- adding up ----------------------------------------------------------------------------------


class _Sums(NamedTuple):
    """What differences add up to, and their extremes, as ``_kernels.overlay`` has them."""

    sums: _Floats
    extremes: _Floats

    @property
    def area(self) -> float:
        return float(self.sums[0])

    def turned(self) -> _Sums:
        """Return those of the first terrain less the second one."""
        from rtin._kernels.overlay import ABOVE, BELOW, MAX, MIN, SLOPE

        sums, extremes = self.sums.copy(), self.extremes.copy()
        sums[[ABOVE, BELOW]] = self.sums[[BELOW, ABOVE]]
        sums[SLOPE] = -self.sums[SLOPE]
        extremes[MAX : MAX + 3] = self.extremes[MIN : MIN + 3]
        extremes[MIN : MIN + 3] = self.extremes[MAX : MAX + 3]
        extremes[[MAX, MIN]] *= -1.0
        return _Sums(sums, extremes)


def _differences(source: Surface, target: Surface, width: float, done: Steps) -> _Sums:
    from rtin._kernels.overlay import MAX, MIN

    tasks = [(source, target, pieces, width, done) for pieces in shares_of(source.n_pieces)]
    parts: list[_Sums] = _parallel.run(_differences_of_pieces, tasks)
    extremes = np.max([part.extremes for part in parts], axis=0)
    highest = max(parts, key=lambda part: part.extremes[MAX])
    lowest = min(parts, key=lambda part: part.extremes[MIN])
    extremes[MAX : MAX + 3] = highest.extremes[MAX : MAX + 3]
    extremes[MIN : MIN + 3] = lowest.extremes[MIN : MIN + 3]
    return _Sums(np.sum([part.sums for part in parts], axis=0), extremes)


def _differences_of_pieces(
    source: Surface, target: Surface, numbers: range, width: float, done: Steps
) -> _Sums:
    from rtin._kernels.overlay import MAX, MIN, N_EXTREMES, N_SUMS, add_differences

    sums, extremes, n_before = np.zeros(N_SUMS), np.zeros(N_EXTREMES), 0
    extremes[MAX], extremes[MIN] = -np.inf, np.inf
    surface, frame, _ = target.search
    seen = np.full(len(surface[-1]), -1, np.int64)
    for number in numbers:
        piece = source.piece(number)
        own = np.zeros(N_SUMS)  # of each piece, so that small figures are not added to large ones
        mesh = piece.vertices, piece.triangles
        add_differences(*mesh, surface, frame, width, n_before, seen, own, extremes)
        sums += own
        n_before += len(piece.triangles)
        done.step()
    return _Sums(sums, extremes)


def _area_from_above(surface: Surface) -> float:
    from rtin._kernels.overlay import area_from_above

    def of_piece(number: int) -> float:
        piece = surface.piece(number)
        return float(area_from_above(piece.vertices, piece.triangles))

    return float(sum(_parallel.run(of_piece, [(number,) for number in range(surface.n_pieces)])))


# --- saying it ----------------------------------------------------------------------------------


def _result(found: _Sums, areas: tuple[float, float], local: Local) -> TerrainDifference:
    from rtin._kernels import overlay

    area, above, below, squares = found.sums[:4].tolist()
    angle, angle_squares, slope, slope_squares = found.sums[4:].tolist()
    extremes = found.extremes.tolist()
    places = found.extremes[
        [[overlay.MAX + 1, overlay.MAX + 2], [overlay.MIN + 1, overlay.MIN + 2]]
    ]
    (max_x, max_y), (min_x, min_y) = local.to_world(places).tolist()
    return TerrainDifference(
        max=extremes[overlay.MAX],
        min=extremes[overlay.MIN],
        mean=(above - below) / area,
        mean_abs=(above + below) / area,
        rms=float(np.sqrt(squares / area)),
        place_of_max=(max_x, max_y),
        place_of_min=(min_x, min_y),
        fill=above,
        cut=below,
        area=area,
        area_only_a=max(0.0, areas[0] - area),
        area_only_b=max(0.0, areas[1] - area),
        normals=_angles(area, angle, angle_squares, extremes[overlay.MAX_ANGLE]),
        slope=_angles(area, slope, slope_squares, extremes[overlay.MAX_SLOPE]),
    )


def _angles(area: float, total: float, total_squares: float, largest: float) -> Angles:
    return Angles(total / area, float(np.sqrt(total_squares / area)), largest)
