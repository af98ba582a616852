"""Pyramids: the same terrain at every zoom, each with its own tolerance and without cracks.

The nodes of a zoom are every second node of the next one. A triangle that some node of a coarser
zoom forbids is therefore forbidden at every finer zoom whose tolerance is not larger: the vertices
of a tile are among those of its children.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import inf, pi
from pathlib import Path
from typing import Any

import numpy as np

from rtin._atomic import replacing
from rtin._decimated import DecimatedLattice, Recording
from rtin._options import as_height
from rtin.schemes import EQUATORIAL_RADIUS, Scheme
from rtin.tiles import HeightLattice, Place, Settled, Tile, Tiling, make_tiles, settle_borders

__all__ = ["Level", "Plan", "geometric_error", "prepare", "shares", "tolerances"]

# CesiumJS: a quarter of the spacing at the equator of 65 heights along a tile of zoom 0.
_EQUATOR = 2.0 * pi * EQUATORIAL_RADIUS
_CESIUM_QUALITY, _CESIUM_HEIGHTS = 0.25, 65


def geometric_error(scheme: Scheme, zoom: int) -> float:
    """Return the error in metres that CesiumJS takes terrain of a zoom to have."""
    return _EQUATOR * _CESIUM_QUALITY / (_CESIUM_HEIGHTS * scheme.roots * 2.0**zoom)


def tolerances(
    first: int, last: int, given: Sequence[float] | None, default: Callable[[int], float]
) -> dict[int, float]:
    """Return a tolerance for each zoom from the first to the last.

    Without any given, they are the default ones. One given is that of the last zoom, doubled for
    each coarser one; several are those of the zooms one by one, from the first on.

    Raises
    ------
    TypeError
        If they are no numbers.
    ValueError
        If one is negative, infinite or NaN, or several are given, but not one for each zoom, or
        they grow with the zoom.
    """
    zooms = range(first, last + 1)
    if isinstance(given, str) or not isinstance(given, Iterable | None):
        raise TypeError(f"max_error must be a list of tolerances, got {given!r}")
    given = [as_height("max_error", value) for value in (() if given is None else given)]
    if inf in given:
        raise ValueError("max_error must be finite, got inf: file formats have no such number")
    if not given:
        return {zoom: default(zoom) for zoom in zooms}
    if len(given) == 1:
        return {zoom: given[0] * 2 ** (last - zoom) for zoom in zooms}
    if len(given) != len(zooms):
        raise ValueError(
            f"max_error must be one tolerance, or one for each of the {len(zooms)} zooms "
            f"{first} to {last}, got {len(given)}"
        )
    if any(np.diff(given) > 0.0):
        raise ValueError(
            "tolerances must not grow with the zoom, or children would lack vertices of their "
            f"parents, got {', '.join(f'{value:g}' for value in given)} from zoom {first} on"
        )
    return dict(zip(zooms, given, strict=True))


@dataclass(frozen=True)
class Plan:
    """What a pyramid is to be.

    Attributes
    ----------
    lattice : HeightLattice
        Of the finest zoom.
    cells : int
        Along a side of every tile: a power of two.
    roots : int
        Tiles side by side at zoom 0.
    tolerances : dict of int to float
        Largest vertical distance of a node from the mesh, for each zoom wanted.
    fill : float or None
        As in ``Tiling``.
    largest_cells : dict of int to int, optional
        ``largest_cell`` of ``Tiling`` for each zoom; by default no tile is cut without need. For
        the zooms to be nested it must not be longer, on the ground, at a finer one.
    margin : float
        Share of the tolerances that is left to the rounding of a file format.
    """

    lattice: HeightLattice
    cells: int
    roots: int
    tolerances: dict[int, float]
    fill: float | None
    largest_cells: dict[int, int] | None = None
    margin: float = 0.0

    @property
    def n_tiles(self) -> int:
        """Tiles of the last zoom that may have heights."""
        return len(self.tiling(self.lattice, max(self.tolerances)).tiles())

    def tiling(self, lattice: HeightLattice, zoom: int) -> Tiling:
        """Return the tiling of a zoom, given its nodes."""
        shape = 1 << zoom, self.roots << zoom
        largest = None if self.largest_cells is None else self.largest_cells[zoom]
        max_error = self.tolerances[zoom] * (1.0 - self.margin)
        return Tiling(lattice, self.cells, max_error, shape, self.fill, largest)


@dataclass(frozen=True)
class Level:
    """One zoom, ready to make its tiles in any order.

    Attributes
    ----------
    zoom : int
    tiling : Tiling
    settled : Settled
    available : frozenset of (int, int)
        Tiles that there are: those with heights, and the parents of those at the next zoom.
    """

    zoom: int
    tiling: Tiling
    settled: Settled
    available: frozenset[Place]

    def with_tiles(self, places: Iterable[Place]) -> Level:
        """Return the same with some more tiles, which hold what fills voids."""
        return replace(self, available=self.available.union(places))

    def make(self, places: Iterable[Place]) -> Iterator[Tile]:
        """Yield these tiles, as far as they are available, row by row."""
        wanted = [place for place in places if place in self.available]
        return make_tiles(self.tiling, wanted, self.settled.borders)


def prepare(
    plan: Plan,
    folder: Path,
    *,
    executor: Executor | None = None,
    tell: Callable[[int, int, int], object] | None = None,
) -> dict[int, Level]:
    """Settle the borders of every zoom, from the finest to the coarsest.

    The finest lattice is read about once. What is found goes to ``folder``, and is taken from there
    if it is there already: the folder belongs to one plan.

    Parameters
    ----------
    plan : Plan
    folder : Path
        For the heights of the coarser zooms (4 or 8 bytes each, a third of the lattice in all) and
        the borders.
    executor : concurrent.futures.Executor, optional
        Where the work is done; its workers must see the same folder.
    tell : callable, optional
        Called with the zoom, the number of its tiles settled so far and of those in sight.

    Raises
    ------
    OSError
        If the lattice can't be read or the folder can't be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    last = max(plan.tolerances)
    decimated = {
        zoom: DecimatedLattice.of(plan.lattice, 2 ** (last - zoom), folder / f"heights-{zoom}")
        for zoom in plan.tolerances
        if zoom != last
    }
    recording = Recording(plan.lattice, tuple(decimated.values()))
    lattices: dict[int, HeightLattice] = {**decimated, last: recording}
    levels: dict[int, Level] = {}
    children: frozenset[Place] = frozenset()
    for zoom in sorted(plan.tolerances, reverse=True):
        tiling = plan.tiling(lattices[zoom], zoom)
        path = folder / f"settled-{zoom}.npz"
        if path.exists():
            settled = _loaded(path)
        else:
            heard = None if tell is None else _about(tell, zoom)
            settled = settle_borders(tiling, executor=executor, tell=heard)
            _save(settled, path)
        available = settled.places | {(row // 2, col // 2) for row, col in children}
        finished = plan.tiling(plan.lattice if zoom == last else lattices[zoom], zoom)
        levels[zoom] = Level(zoom, finished, settled, available)
        children = available if plan.fill is not None else frozenset()
    return dict(sorted(levels.items()))


def shares(plan: Plan, tell: Callable[[float], object]) -> Callable[[int, int, int], object]:
    """Return what ``prepare`` may call, and tells the share of all its work that is done."""
    last = max(plan.tolerances)
    weights = {zoom: 4.0 ** (zoom - last) for zoom in plan.tolerances}
    whole = sum(weights.values())

    def heard(zoom: int, done: int, in_sight: int) -> None:
        finer = sum(weight for other, weight in weights.items() if other > zoom)
        tell((finer + weights[zoom] * done / in_sight) / whole)

    return heard


def _about(tell: Callable[[int, int, int], object], zoom: int) -> Callable[[int, int], object]:
    return lambda done, in_sight: tell(zoom, done, in_sight)


# --- what is settled, on disk -------------------------------------------------------------------


def _save(settled: Settled, path: Path) -> None:
    edges = sorted(settled.borders)
    length = max((mark.bit_length() for mark in settled.borders.values()), default=0) // 8 + 1
    marks = b"".join(settled.borders[edge].to_bytes(length, "little") for edge in edges)
    with replacing(path) as part:
        np.savez(
            part.with_suffix(".npz"),
            edges=np.array(edges, np.int32).reshape(-1, 3),
            marks=np.frombuffer(marks, np.uint8).reshape(len(edges), length),
            places=np.array(sorted(settled.places), np.int32).reshape(-1, 2),
            largest_range=settled.largest_range,
        )


def _loaded(path: Path) -> Settled:
    with np.load(path) as saved:
        edges = map(tuple, saved["edges"].tolist())
        marks = (int.from_bytes(row.tobytes(), "little") for row in saved["marks"])
        places = frozenset(map(tuple, saved["places"].tolist()))
        borders: Any = dict(zip(edges, marks, strict=True))
        return Settled(borders, places, float(saved["largest_range"]))
