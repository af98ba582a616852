"""The mesh of the least sum of squared vertical errors, for what a vertex may cost.

Adding a vertex to a mesh that has its parents changes only the two triangles that share the edge it
bisects, so the sum of squared errors falls by the same *gain* whatever else the mesh holds:

    SSE(K) = SSE(coarsest) - sum of gain(v) over the vertices v added

and the mesh that minimises SSE(K) + weight * |K| is the closed set of the largest total of
gain - weight: one minimum cut (Picard, "Maximal closure of a graph and applications to
combinatorial problems", 1976). The best sets for falling weights are nested.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtin import _parallel
from rtin.grid import Grid, lattice_size

__all__ = ["keep_best", "keep_within", "may_hold_all", "vertex_gains"]

_Gains = NDArray[np.float64]
_Items = NDArray[np.int64]
_Kept = NDArray[np.uint8]
_Room = NDArray[np.int64]  # vertices, triangles

_STEP = 4.0  # between weights, until one fits the budget and the next does not
_LEAST_SHARE = 2.0**-60  # of the largest gain: below it all is rounding
_FILLING = (0.5, 0.05, 0.0)  # shares of the weight that a vertex must gain to fill up a budget


def vertex_gains(grid: Grid) -> _Gains:
    """Return by how much each vertex lowers the sum of squared errors of a mesh it is added to.

    In the square of the heights' unit, float64 of the grid's shape; it may be less than zero. NaN
    where a triangle with that vertex at the middle of its hypotenuse has a void; 0 at the
    lattice's corners. Every sample counts once. The time is proportional to the samples.
    """
    from rtin._kernels.squared_error import add_gains

    size = lattice_size(grid.shape)
    gains, diagonals = np.zeros(grid.shape), np.zeros((2, size + 1))
    n_depths = 2 * (size.bit_length() - 1)
    if n_depths > 0:
        roots = np.array([[[0, 0, size], [size, 0, size]], [[size, size, 0], [0, size, 0]]])
        common = (grid.heights, n_depths)
        tasks = [(*common, roots[i], gains, diagonals[i]) for i in (0, 1)]
        _parallel.run(add_gains, tasks)
        at = np.arange(min(grid.shape))
        gains[at, at] = diagonals.sum(axis=0)[at]
        _add_along_the_border(grid, size, gains)
    return gains


def keep_best(gains: _Gains, kept: _Kept, weight: float) -> None:
    """Keep, besides a closed set, the vertices that make SSE + weight * vertices least.

    The fewest of them where there is a choice. ``kept`` has a byte for each vertex of the lattice.
    """
    from rtin._kernels.squared_error import keep_all

    keep_all(kept, _best(gains, kept, weight))


def may_hold_all(gains: _Gains, kept: _Kept, room: _Room) -> bool:
    """Return whether there is room for all that gain: the lossless mesh has every one of them."""
    return bool(np.count_nonzero(_above(gains, kept, 0.0)) <= room[0])


def keep_within(gains: _Gains, kept: _Kept, room: _Room) -> None:
    """Keep, besides a closed set, as many vertices as there is room for.

    The best set for the least possible weight. Then parts of the next one, which are as good; and
    greedily what still fits. ``room`` is how many vertices and how many triangles may be added.
    """
    from rtin._kernels.squared_error import keep_greedily, keep_parts

    room = room.copy()
    weight, finer = _keep_until_too_fine(gains, kept, room)
    weight, finer = _keep_up_to_the_last(gains, kept, room, weight, finer)
    room = keep_parts(gains.shape, kept, finer, _no_numbers(gains), room)
    for share in _FILLING:
        if room.min() > 0:
            items = _not_kept_above(gains, kept, share * weight)
            room = keep_greedily(gains, kept, items, room)


def _keep_until_too_fine(gains: _Gains, kept: _Kept, room: _Room) -> tuple[float, _Items]:
    """Keep the best sets of falling weights while there is room; ``room`` is what remains of it.

    Returns the weight of the first set that is too large, and the vertices that it has more.
    """
    from rtin._kernels.squared_error import keep_all

    weight = _first_weight(gains, kept, room)
    least = _LEAST_SHARE * weight
    while weight > least:
        finer = _best(gains, kept, weight)
        needed = _needed(gains, finer)
        if (needed > room).any():
            return weight, finer
        keep_all(kept, finer)
        room -= needed
        weight /= _STEP
    return weight, np.empty(0, np.int64)


def _keep_up_to_the_last(
    gains: _Gains,
    kept: _Kept,
    room: _Room,
    least_weight: float,
    finer: _Items,
) -> tuple[float, _Items]:
    """Keep the last best set that fits; return the weight of the next, and what that has more.

    ``finer`` is what a set has more that is too large, the best one for ``least_weight``.
    """
    from rtin._kernels.squared_error import best_closed_set, gains_of, keep_all

    number, weight = _no_numbers(gains), least_weight
    while finer.size > 0:
        # For their mean gain, the sets with and without all these are equally good; what is best
        # lies between, or there is nothing between. Large gains would make for small steps.
        mean = float(gains_of(finer, gains).mean())
        weight = min(mean, _STEP * least_weight)
        chosen = best_closed_set(finer, gains, weight, number)
        if not chosen.any() or (chosen.all() and weight == mean):
            break
        needed = _needed(gains, finer[chosen])
        if (needed <= room).all():
            keep_all(kept, finer[chosen])
            room -= needed
            finer = finer[~chosen]
        else:
            finer, least_weight = finer[chosen], weight
    return weight, finer


def _first_weight(gains: _Gains, kept: _Kept, room: _Room) -> float:
    """Return a weight whose best set may be about as large as the room."""
    found = gains[_above(gains, kept, 0.0)]
    wanted = int(min(room[0], room[1] // 2))
    if found.size == 0:
        return 0.0
    place = max(0, found.size - 1 - wanted)
    return float(np.partition(found, place)[place])


def _best(gains: _Gains, kept: _Kept, weight: float) -> _Items:
    from rtin._kernels.squared_error import best_closed_set, candidates

    number = _no_numbers(gains)
    items = candidates(gains, weight, kept, number)
    return np.asarray(items[best_closed_set(items, gains, weight, number)])


def _needed(gains: _Gains, items: _Items) -> _Items:
    """Return how many vertices and triangles more some vertices make."""
    from rtin._kernels.squared_error import triangles_gained_by

    return np.array([items.size, triangles_gained_by(items, *gains.shape)])


def _above(gains: _Gains, kept: _Kept, least: float) -> NDArray[np.bool_]:
    """Return which vertices gain more than that, and are not kept."""
    return np.asarray((gains > least) & (kept[: gains.shape[0], : gains.shape[1]] == 0))


def _not_kept_above(gains: _Gains, kept: _Kept, least: float) -> _Items:
    from rtin._kernels.lattice import VERTEX, pack

    rows, cols = np.nonzero(_above(gains, kept, least))
    return np.asarray(pack(rows, cols, VERTEX))


def _no_numbers(gains: _Gains) -> NDArray[np.int32]:
    """Return room for the place of each vertex in a list; the kernels leave it as it is here."""
    return np.full(gains.shape, -1, np.int32)


def _add_along_the_border(grid: Grid, size: int, gains: _Gains) -> None:
    """Make the samples on the lattice's border count whole, like those of other shared edges."""
    from rtin._kernels.squared_error import add_gains_along

    for heights, gains_of_side in ((grid.heights, gains), (grid.heights.T, gains.T)):
        for side in {0, size} & {0, len(heights) - 1}:
            line, more = np.full(size + 1, np.nan), np.zeros(size + 1)
            line[: heights.shape[1]] = heights[side]
            add_gains_along(line, more)
            gains_of_side[side] += more[: heights.shape[1]]
