"""Distances between surfaces: sampled as Metro does, and certified.

The distance of a point p from a surface S is the smallest Euclidean distance from p to a point of
S. Between two surfaces A and B there are, from A to B (*forward*) and from B to A (*backward*), the
maximum of it over the first surface, its mean and its root mean square; the larger of the two
maxima is the Hausdorff distance (Suárez and Plaza, §3, definitions 1 to 4). ``compare`` estimates
all of them from samples; ``hausdorff`` gives bounds of the maximum that hold.

Sources: P. Cignoni, C. Rocchini and R. Scopigno, "Metro: measuring error on simplified surfaces",
Computer Graphics Forum 17(2), 1998.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from dataclasses import field as hidden
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtin import _parallel
from rtin._number import as_number
from rtin._pairs import Progress, Steps, shares_of, two_surfaces
from rtin._sampling import SAMPLINGS, Sampling, SurfaceSamples, samples_of
from rtin._surfaces import Local, Surface
from rtin.grid import Grid
from rtin.mesh import TriangleMesh

__all__ = [
    "SAMPLINGS",
    "CertifiedDistance",
    "Field",
    "OneSided",
    "Progress",
    "Sampling",
    "SurfaceDistance",
    "compare",
    "hausdorff",
    "is_compiled",
]

_Floats = NDArray[np.float64]

_SAMPLES_PER_TRIANGLE = 10  # Metro's
_MOST_SAMPLES = 10**15
_SMALLEST_TOLERANCE = 1e-12  # of the largest coordinate: less is rounding
_DEFAULT_TOLERANCE = 1e-3  # of the distance
_LEAST_BY_DEFAULT = 1e-9  # of the largest coordinate
_ROUNDING = 1e-15  # of a product


class Field(NamedTuple):
    """Samples of a surface, and how far each is from the other one.

    Attributes
    ----------
    points : ndarray of float64, shape (n, 3)
        In the units of the CRS and of the heights.
    distances : ndarray of float64, shape (n,)
        In the unit of the heights.
    areas : ndarray of float64, shape (n,)
        Area that a sample stands for, in the square of that unit; 0 for those at vertices and on
        edges. They add up to the surface's area, less some triangles too small for a sample of
        their own.
    """

    points: _Floats
    distances: _Floats
    areas: _Floats


@dataclass(frozen=True, eq=False)
class OneSided:
    """Distances of the samples of one surface from the other one, in the unit of the heights.

    Attributes
    ----------
    max, mean, rms : float
        Over all samples alike, as Metro has them.
    area_mean, area_rms : float
        Over the samples inside triangles, each weighted by the area that it stands for: these
        estimate the surface integrals of the definitions. NaN where no sample is inside one. Where
        triangles get only a point or two, points in the middle are nearer than the edges: then
        "montecarlo" alone is without bias (of 2.5 % in rms at two points a triangle of mountains).
    place : (float, float, float)
        The first sample at the largest distance, in the units of the CRS and of the heights.
    n_samples : int
    field : Field
        All samples, computed again when first asked for: 40 bytes a sample.
    """

    max: float
    mean: float
    rms: float
    area_mean: float
    area_rms: float
    place: tuple[float, float, float]
    n_samples: int
    _histogram: NDArray[np.int64] = hidden(repr=False)
    _way: _Way = hidden(repr=False)

    @cached_property
    def field(self) -> Field:
        """All samples with their distances and areas."""
        tasks = [(number,) for number in range(self._way.samples.surface.n_pieces)]
        parts = _parallel.run(self._way.field_of_piece, tasks)
        points, distances, areas = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return Field(self._way.local.to_world(points), distances, areas)

    def quantile(self, share: float) -> float:
        """Return the distance that so large a share of all samples does not exceed.

        Within 0.05 % of the sample's distance, but for those below 1e-38.

        Raises
        ------
        ValueError
            If ``share`` is not between 0 and 1.
        """
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a share between 0 and 1 is wanted, got {share}")
        counts = np.cumsum(self._histogram)
        product = share * self.n_samples * (1.0 - _ROUNDING)  # 0.07 · 100 is above 7
        rank = max(1, int(np.ceil(product)))
        return min(self.max, _middle_of_bin(int(np.searchsorted(counts, rank))))


@dataclass(frozen=True, eq=False)
class SurfaceDistance:
    """How far two surfaces are from each other, from samples.

    Attributes
    ----------
    forward, backward : OneSided
        From the first surface to the second, and back.
    hausdorff : float
        The larger of both maxima: never more than the Hausdorff distance, and somewhat less where
        no sample hits its place.
    """

    forward: OneSided
    backward: OneSided

    @property
    def hausdorff(self) -> float:
        """The larger of both maxima."""
        return max(self.forward.max, self.backward.max)

    def __repr__(self) -> str:
        sides = "; ".join(
            f"{name} max {side.max:.6g}, rms {side.rms:.6g}, mean {side.mean:.6g} "
            f"over {side.n_samples} samples"
            for name, side in (("forward", self.forward), ("backward", self.backward))
        )
        return f"<SurfaceDistance {sides}>"


class Bounds(NamedTuple):
    """Bounds of the largest distance from one surface to another.

    Attributes
    ----------
    lower, upper : float
        In the unit of the heights.
    place : (float, float, float)
        A point of the surface that is ``lower`` from the other one, in the units of the CRS and of
        the heights.
    """

    lower: float
    upper: float
    place: tuple[float, float, float]


@dataclass(frozen=True)
class CertifiedDistance:
    """Bounds of the Hausdorff distance, in the unit of the heights.

    Attributes
    ----------
    forward, backward : Bounds
        Of the largest distance from the first surface to the second, and back.
    """

    forward: Bounds
    backward: Bounds

    @property
    def lower(self) -> float:
        """The Hausdorff distance is at least this."""
        return max(self.forward.lower, self.backward.lower)

    @property
    def upper(self) -> float:
        """The Hausdorff distance is at most this."""
        return max(self.forward.upper, self.backward.upper)

    @property
    def place(self) -> tuple[float, float, float]:
        """A point of one surface that is ``lower`` from the other one."""
        return max(self.forward, self.backward).place


def compare(
    mesh_a: TriangleMesh | Grid,
    mesh_b: TriangleMesh | Grid,
    sampling: Sampling = "subdivision",
    *,
    samples: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> SurfaceDistance:
    """Return how far two surfaces are from each other, in both directions, as Metro measures it.

    Samples are the corners of all triangles, then points on edges, then points inside triangles;
    from each the distance to the other surface is exact up to the rounding of float64. What they
    do *not* promise is the maximum between them, which ``hausdorff`` bounds.

    Parameters
    ----------
    mesh_a, mesh_b : TriangleMesh or Grid
        A grid stands for its finest triangles. Vertices without a triangle are no part of a
        surface; a triangle without an area counts as its edges. The surfaces need not overlap.
    sampling : {"subdivision", "montecarlo", "similar", "vertices"}
        Where a triangle's points lie: in the centres of 2**⌊log2 n⌋ parts, halved at the longest
        edge each time; at random; on a regular lattice; or nowhere but at the corners.
    samples : int, optional
        How many to take of each surface, 10 times the larger number of triangles by default. Of
        these every corner is one, whatever the number; edges get points at √(s) per unit of length
        and triangles at s per unit of area, s being what is left over the surface's area. Edges
        take no more than nine tenths, which they would among slivers only. What is left of a point
        is carried from edge to edge and from triangle to triangle. Some methods take a little
        fewer.
    seed : int
        Of the random points: the same seed gives the same ones.
    progress : callable, optional
        Gets the share that is done, from 0 to 1, now and then.

    Returns
    -------
    SurfaceDistance
        In the unit of the heights, which x and y share unless the CRS is geographic: then x and y
        are scaled to metres about the middle of both. The same bytes on any number of threads.

    Raises
    ------
    TypeError
        If a surface is neither a TriangleMesh nor a Grid, or a number is of the wrong kind.
    ValueError
        If a surface has no triangle or a vertex that is not finite, the surfaces have unlike CRS or
        are larger than 1e50, ``sampling`` is unknown, ``samples`` is below 1 or above 10**15,
        or ``seed`` is below 0.
    """
    if sampling not in SAMPLINGS:
        raise ValueError(f"sampling must be one of {', '.join(SAMPLINGS)}, got {sampling!r}")
    local, a, b = two_surfaces(mesh_a, mesh_b)
    wanted = _SAMPLES_PER_TRIANGLE * max(a.n_triangles, b.n_triangles)
    if samples is not None:
        wanted = _as_count("samples", samples)
        if wanted > _MOST_SAMPLES:
            raise ValueError(f"samples must be {_MOST_SAMPLES} or fewer, got {str(wanted)[:20]}")
    first_seed = _as_count("seed", seed, least=0)
    done = Steps(progress, a.n_pieces + b.n_pieces)
    ways = [
        _Way(samples_of(source, sampling, wanted, (first_seed,)), target, local)
        for source, target in [(a, b), (b, a)]
    ]
    return SurfaceDistance(*(_one_sided(way, done) for way in ways))


def hausdorff(
    mesh_a: TriangleMesh | Grid,
    mesh_b: TriangleMesh | Grid,
    *,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> CertifiedDistance:
    """Return bounds of the Hausdorff distance between two surfaces that hold.

    By branch and bound. The distance to one triangle is convex, so that no point of a convex
    polygon is farther from it than the farthest corner. A triangle of one surface is divided into
    polygons, each with a triangle of the other surface for itself: at the edges of those below and
    above it where these are few (the overlay of both), at places that are equally far from two, or
    not at all. Where the farthest corner leaves the maximum open, the triangle is bisected at its
    longest edge. Any division gives a bound, so that overlaps, upright triangles, gaps and voids
    cost time at most; so does a maximum along a whole curve that is equally far from triangles on
    both sides, where parts get as small as the root of the tolerance.

    Parameters
    ----------
    mesh_a, mesh_b : TriangleMesh or Grid
        As for ``compare``.
    tolerance : float, optional
        How far the bounds may be apart, in the unit of the heights. By default a thousandth of the
        largest distance of a sample, or 1e-9 of the largest local coordinate if that is more. What
        is less than 1e-12 of that coordinate, and so near to rounding, counts as that much.
    progress : callable, optional
        Gets the share that is done, from 0 to 1, now and then.

    Returns
    -------
    CertifiedDistance
        ``lower`` ≤ the Hausdorff distance ≤ ``upper`` ≤ ``lower`` + ``tolerance``, up to the
        rounding of float64. The same bytes on any number of threads.

    Raises
    ------
    TypeError, ValueError
        As ``compare`` does; ValueError if ``tolerance`` is not above zero.
    """
    wanted = None if tolerance is None else as_number("tolerance", tolerance)
    if wanted is not None and not wanted > 0.0:
        raise ValueError(f"tolerance must be above zero, in the heights' units, got {wanted}")
    local, a, b = two_surfaces(mesh_a, mesh_b)
    done = Steps(progress, 2 * (a.n_pieces + b.n_pieces))
    n_samples = 2 * max(a.n_triangles, b.n_triangles)
    ways = [
        _Way(samples_of(source, "similar", n_samples, (0,)), target, local)
        for source, target in [(a, b), (b, a)]
    ]
    reached = [_farthest_sample(way, done) for way in ways]
    size = max(local.extent, a.highest, b.highest)
    if wanted is None:
        found = max(lower for lower, _ in reached)
        wanted = max(_DEFAULT_TOLERANCE * found, _LEAST_BY_DEFAULT * size)
    gap = max(wanted, _SMALLEST_TOLERANCE * size)
    return CertifiedDistance(
        *(_bounds(way, *start, gap, done) for way, start in zip(ways, reached, strict=True))
    )


def is_compiled() -> bool:
    """Return whether compiled kernels lie on disk: the first call on a machine takes longer."""
    from rtin._kernels._jit import compiled_before
    from rtin._kernels.distance import nearest_on_surface

    return compiled_before(nearest_on_surface)


# --- from samples -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Way:
    """From the samples of one surface to another surface, both in the local system."""

    samples: SurfaceSamples
    target: Surface
    local: Local

    def field_of_piece(self, number: int) -> tuple[_Floats, _Floats, _Floats]:
        chunks = list(self.samples.of_piece(number))
        points = np.concatenate([np.empty((0, 3)), *(chunk.points for chunk in chunks)])
        areas = np.concatenate([np.empty(0), *(chunk.areas for chunk in chunks)])
        return points, np.sqrt(self.target.nearest(points)[0]), areas


@dataclass
class _Statistics:
    """What some samples say together."""

    sums: _Floats  # as _kernels.sampling.summarise has them
    n_samples: int = 0
    max: float = -1.0
    place: _Floats | None = None


class _Histogram:
    """Counts of distances, kept in one array for each thread that counts at the same time."""

    def __init__(self) -> None:
        self._idle: list[NDArray[np.int64]] = []

    @contextmanager
    def counts(self) -> Iterator[NDArray[np.int64]]:
        """Give an array to add to that no other thread has."""
        from rtin._kernels.sampling import N_BINS

        try:
            counts = self._idle.pop()
        except IndexError:
            counts = np.zeros(N_BINS, np.int64)
        yield counts
        self._idle.append(counts)

    def total(self) -> NDArray[np.int64]:
        """Return the sum of all arrays, once nobody counts any more."""
        return np.asarray(np.sum(self._idle, axis=0))


def _statistics(way: _Way, histogram: _Histogram, done: Steps) -> list[_Statistics]:
    shares = shares_of(way.samples.surface.n_pieces)
    tasks = [(way, numbers, histogram, done) for numbers in shares]
    parts: list[_Statistics] = _parallel.run(_statistics_of_pieces, tasks)
    return parts


def _farthest_sample(way: _Way, done: Steps) -> tuple[float, _Floats]:
    worst = max(_statistics(way, _Histogram(), done), key=lambda part: part.max)
    assert worst.place is not None, "each surface has a corner, and each corner is a sample"
    return worst.max, worst.place


def _one_sided(way: _Way, done: Steps) -> OneSided:
    histogram = _Histogram()
    parts = _statistics(way, histogram, done)
    worst = max(parts, key=lambda part: part.max)
    n_samples = sum(part.n_samples for part in parts)
    total, total_squares, area, area_total, area_squares = np.sum(
        [part.sums for part in parts], axis=0
    ).tolist()
    assert worst.place is not None, "each surface has a corner, and each corner is a sample"
    return OneSided(
        max=worst.max,
        mean=total / n_samples,
        rms=float(np.sqrt(total_squares / n_samples)),
        area_mean=area_total / area if area > 0.0 else np.nan,
        area_rms=float(np.sqrt(area_squares / area)) if area > 0.0 else np.nan,
        place=_place(worst.place, way.local),
        n_samples=n_samples,
        _histogram=histogram.total(),
        _way=way,
    )


def _statistics_of_pieces(
    way: _Way, numbers: range, histogram: _Histogram, done: Steps
) -> _Statistics:
    """Return what the samples of some pieces say."""
    from rtin._kernels.sampling import summarise

    found = _Statistics(np.zeros(5))
    for number in numbers:
        for points, areas in way.samples.of_piece(number):
            distances, _ = way.target.nearest(points)
            with histogram.counts() as counts:
                sums, worst = summarise(distances, areas, counts)
            found.sums += sums
            found.n_samples += len(points)
            if distances[worst] > found.max:
                found.max, found.place = float(distances[worst]), points[worst]
        done.step()
    return found


def _middle_of_bin(number: int) -> float:
    """Return a distance of one bin of the histogram."""
    from rtin._kernels.sampling import DROPPED_BITS

    bits = np.array([number << DROPPED_BITS, (number + 1) << DROPPED_BITS], np.int32)
    return float(bits.view(np.float32).astype(np.float64).mean()) if number else 0.0


# --- bounds -------------------------------------------------------------------------------------


def _bounds(way: _Way, lower: float, place: _Floats, gap: float, done: Steps) -> Bounds:
    """Return bounds of the largest distance, given a point and its distance.

    All pieces start from that: what they find does not depend on which of them is first.
    """
    source, target, local = way.samples.surface, way.target, way.local
    shares = list(shares_of(source.n_pieces))
    tasks = [(source, target, numbers, lower, gap, done) for numbers in shares]
    upper = lower
    for part_lower, part_upper, part_place in _parallel.run(_bounds_of_pieces, tasks):
        upper = max(upper, part_upper)
        if part_lower > lower:
            lower, place = part_lower, part_place
    return Bounds(lower, upper, _place(place, local))


def _bounds_of_pieces(
    source: Surface, target: Surface, numbers: range, lower: float, gap: float, done: Steps
) -> tuple[float, float, _Floats]:
    from rtin._kernels.hausdorff import bound_largest

    upper, place = lower, np.full(3, np.nan)
    for number in numbers:
        piece = source.piece(number)
        corners, triangles = np.unique(piece.triangles, return_inverse=True)
        vertices = piece.vertices[corners]
        known = target.nearest(vertices)
        part_lower, part_upper, part_place = bound_largest(
            vertices, triangles.reshape(-1, 3), *known, *target.search, lower, gap
        )
        upper = max(upper, part_upper)
        if part_lower > lower:
            lower, place = part_lower, np.array(part_place)
        done.step()
    return lower, upper, place


# --- numbers and places --------------------------------------------------------------------------


def _as_count(name: str, value: Any, least: int = 1) -> int:  # noqa: ANN401
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise ValueError(f"{name} must be {least} or more, got {value}")
    return int(value)


def _place(point: _Floats, local: Local) -> tuple[float, float, float]:
    x, y, z = local.to_world(point[np.newaxis])[0].tolist()
    return x, y, z
