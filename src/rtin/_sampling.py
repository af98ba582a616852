"""Metro's samples of a surface, a bounded number of them at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rtin import _parallel
from rtin._surfaces import Piece, Surface

__all__ = ["SAMPLINGS", "Sampling", "SurfaceSamples", "samples_of"]

Sampling: TypeAlias = Literal["subdivision", "montecarlo", "similar", "vertices"]
_Floats = NDArray[np.float64]
_Numbers = NDArray[np.int64]

SAMPLINGS: tuple[Sampling, ...] = ("subdivision", "montecarlo", "similar", "vertices")
_AT_A_TIME = 1 << 16
_MOST_IN_A_PART = 1 << 12  # of a large triangle
_MOST_ON_EDGES = 0.9  # of all points: slivers would have them without end
_NO_AREA = 1e-30  # in units of the edges' length, squared
_SPARE = 1e-6  # of a point, so that rounding does not lose the last one


class Chunk(NamedTuple):
    """Samples, shape (n, 3), and the area that each stands for."""

    points: _Floats
    areas: _Floats


class _Size(NamedTuple):
    """What a piece, or a surface, measures."""

    n_corners: float
    length: float
    area: float


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """The samples of a surface, piece by piece.

    Attributes
    ----------
    surface : Surface
    sampling : str
    seed : tuple of int
    before : list of _Size
        What the pieces before each one measure together.
    per_length, per_area : float
        Points on a unit of the edges' length, and in a unit of area.
    """

    surface: Surface
    sampling: Sampling
    seed: tuple[int, ...]
    before: list[_Size]
    per_length: float
    per_area: float

    def of_piece(self, number: int) -> Iterator[Chunk]:
        """Yield the samples of a piece: corners, then those on edges, then those in triangles."""
        piece, before = self.surface.piece(number), self.before[number]
        for first in range(0, len(piece.corners), _AT_A_TIME):
            corners = piece.corners[first : first + _AT_A_TIME]
            yield _without_area(piece.vertices[corners])
        if self.per_length > 0.0:
            yield from self._on_edges(piece, _fraction(before.length * self.per_length))
        if self.per_area > 0.0:
            rng = np.random.default_rng((*self.seed, number))
            yield from self._in_triangles(piece, _fraction(before.area * self.per_area), rng)

    def _on_edges(self, piece: Piece, owed: float) -> Iterator[Chunk]:
        from rtin._kernels import sampling

        counts = np.empty(len(piece.edges), np.int64)
        sampling.count_on_edges(piece.vertices, piece.edges, self.per_length, owed, counts)
        for first, end, n_points in _shares(counts):
            points = np.empty((n_points, 3))
            edges = piece.edges[first:end]
            sampling.place_on_edges(piece.vertices, edges, counts[first:end], points)
            yield _without_area(points)

    def _in_triangles(self, piece: Piece, owed: float, rng: np.random.Generator) -> Iterator[Chunk]:
        from rtin._kernels import sampling

        method = {
            "subdivision": sampling.SUBDIVISION,
            "similar": sampling.SIMILAR,
            "montecarlo": sampling.RANDOM,
        }[self.sampling]
        shape = piece.vertices, piece.triangles, _MOST_IN_A_PART / self.per_area
        parts = np.empty((sampling.count_parts(*shape), 9))
        part_areas = np.empty(len(parts))
        sampling.fill_parts(*shape, parts, part_areas)
        counts, stands_for = np.empty(len(parts), np.int64), np.empty(len(parts))
        sampling.count_in_parts(part_areas, self.per_area, owed, method, counts, stands_for)
        for first, end, n_points in _shares(counts):
            rolls = rng.random((n_points if method == sampling.RANDOM else 0, 2))
            chunk = Chunk(np.empty((n_points, 3)), np.empty(n_points))
            own = parts[first:end], counts[first:end], stands_for[first:end]
            sampling.place_in_parts(*own, method, rolls, *chunk)
            yield chunk


def samples_of(
    surface: Surface, sampling: Sampling, wanted: int, seed: tuple[int, ...]
) -> SurfaceSamples:
    """Return about so many samples of a surface, as ``rtin.compare`` describes them."""
    sizes = _parallel.run(_size_of_piece, [(surface, i) for i in range(surface.n_pieces)])
    ends = np.cumsum(np.array(sizes), axis=0)
    before = [_Size(*row) for row in (ends - sizes).tolist()]
    total = _Size(*ends[-1].tolist())
    left = wanted - total.n_corners
    if sampling == "vertices" or left <= 0.0 or total.length == 0.0:
        return SurfaceSamples(surface, sampling, seed, before, 0.0, 0.0)
    per_length = (np.floor(_MOST_ON_EDGES * left) + _SPARE) / total.length
    has_area = total.area > _NO_AREA * total.length**2
    if has_area:
        per_length = min(per_length, float(np.sqrt(left / total.area)))
    left += _SPARE - np.floor(total.length * per_length)
    per_area = left / total.area if has_area else 0.0
    return SurfaceSamples(surface, sampling, seed, before, per_length, per_area)


def _size_of_piece(surface: Surface, number: int) -> _Size:
    from rtin._kernels.sampling import total_area, total_length

    piece = surface.piece(number)
    length = total_length(piece.vertices, piece.edges)
    return _Size(len(piece.corners), length, total_area(piece.vertices, piece.triangles))


def _without_area(points: _Floats) -> Chunk:
    return Chunk(points, np.zeros(len(points)))


def _fraction(value: float) -> float:
    return value - float(np.floor(value))


def _shares(counts: _Numbers) -> Iterator[tuple[int, int, int]]:
    """Yield first, end and sum of shares of the counts that add up to few at a time."""
    ends = np.cumsum(counts)
    n_shares = int(ends[-1]) // _AT_A_TIME + 1 if len(ends) else 0
    edges = np.searchsorted(ends, np.arange(1, n_shares) * _AT_A_TIME, side="left") + 1
    for first, end in pairwise([0, *edges.tolist(), len(counts)]):
        n_points = int(counts[first:end].sum())
        if n_points > 0:
            yield first, end, n_points
