"""Fitting: other heights for the vertices of a mesh, so that it lies closer to its raster.

Least squares over all samples that the mesh covers. Where a tolerance is promised, what of an error
is beyond it costs extra, more and more from step to step (the quadratic penalty method, with one
Newton step for each penalty; Nocedal and Wright, "Numerical Optimization", chapter 17), and where
something still is beyond it in the end, the vertices around go back towards where they were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, repeat
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin import _parallel
from rtin._options import as_height, as_tolerance_map
from rtin.criteria import members_by_band, triangles_off, vertical_error
from rtin.grid import Grid, require_grid
from rtin.mesh import TriangleMesh, require_mesh

__all__ = ["fit_heights", "fitted"]

_Heights = NDArray[np.float64]
_Numbers = NDArray[np.integer[Any]]
_Mask = NDArray[np.bool_]
_Tolerance = NDArray[np.float64]  # of the raster's shape, or (1, 1)

_DETERMINED = 0.25
_STIFFNESSES = 10.0 ** np.arange(1, 8)
_EXACTLY, _ROUGHLY = 1e-11, 1e-3  # what conjugate gradients leave of the residual
_MOST_ROUNDS = 1000
_RINGS = 2  # more changed no figure by a millionth, and took longer
_HALVINGS = 6
_ROUNDING = 4.0  # units in the last place of the largest height


def fit_heights(
    mesh: TriangleMesh, grid: Grid, *, max_error: float | ArrayLike | None = None
) -> TriangleMesh:
    """Return the mesh with its vertices moved up or down until it lies close to all samples.

    The sum of squared vertical errors over the samples that the mesh covers is minimised. Places,
    triangles, tags and CRS stay. The mesh may come from anywhere, as in ``vertical_error``.

    Parameters
    ----------
    mesh : TriangleMesh
    grid : Grid
        In the coordinates of the mesh.
    max_error : float or array_like, shape (rows, cols), optional
        Move vertices only so far that every covered sample still lies within this vertical distance
        of the surface, in the unit of the heights. The mesh must do so to begin with.

    Returns
    -------
    TriangleMesh
        Without ``max_error`` the least squares solution. Vertices that the samples hardly
        determine (their weights at all samples, squared, add up to less than 1/4: those without a
        sample nearby) stay where they are; vertices at a covered sample never are among them.
        With ``max_error`` *guaranteed* within it, as ``vertical_error`` measures, at every sample
        that was so before; *not guaranteed* to be the least squares under this condition, only
        close to it. The sum of squares is never larger than before, up to its rounding. The same
        bytes on any number of threads.

    Raises
    ------
    TypeError
        If ``mesh`` is not a TriangleMesh, ``grid`` not a Grid or ``max_error`` no number.
    ValueError
        If the mesh covers no valid sample or has a vertex that is not finite; ``max_error`` is
        negative, or NaN where there is a height, or of another shape; or the mesh is farther than
        that from a sample.
    """
    require_mesh(mesh)
    require_grid(grid)
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("a mesh with finite vertices is wanted, got NaN or infinity in one")
    if max_error is None:
        allowed = np.full((1, 1), np.inf)
    elif np.ndim(max_error) == 0:
        allowed = np.array([[as_height("max_error", max_error)]])
    else:
        allowed = as_tolerance_map(grid, "max_error", max_error)
    _require_within(mesh, grid, allowed)
    return fitted(mesh, grid, allowed)


def fitted(mesh: TriangleMesh, grid: Grid, allowed: _Tolerance) -> TriangleMesh:
    """Return what ``fit_heights`` does, for arguments that are known to be good.

    ``allowed`` is of the raster's shape, or has one row and column for all samples. Where the mesh
    is beyond it already, as rounding can make it, the triangle keeps its heights.
    """
    given = np.ascontiguousarray(mesh.vertices[:, 2])
    samples = _samples_of(mesh, grid, allowed)
    heights, free, before = _least_squares(samples, given)
    if (allowed < np.inf).any():
        heights = _pressed(samples, free, heights)
        heights = _brought_back(samples, given, heights)
    _, after, _ = _sums(samples, heights, 0.0)
    if not after < before:
        return mesh
    vertices = np.column_stack([mesh.vertices[:, :2], heights])
    return TriangleMesh(vertices, mesh.triangles, mesh.crs, mesh.tags)


# --- steps --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Samples:
    """The samples that a mesh covers, each with the one triangle that it counts for."""

    grid: Grid
    places: NDArray[np.float64]  # row and column of each vertex
    triangles: NDArray[np.int32]
    starts: NDArray[np.int64]  # of each triangle in the list of samples
    samples: NDArray[Any]
    allowed: _Tolerance


def _samples_of(mesh: TriangleMesh, grid: Grid, allowed: _Tolerance) -> _Samples:
    from rtin._kernels.fitting import count_samples, fill_owners, list_samples

    places, heights = grid.places(mesh.vertices[:, :2]), grid.heights
    owners = np.full(grid.shape, -1, np.int32)
    rows = _parallel.row_bands(grid.shape[0])
    tasks = [
        (places, mesh.triangles, members, first, owners[first:end])
        for first, end, members in members_by_band(places, mesh.triangles, rows)
    ]
    _parallel.run(fill_owners, tasks)
    starts = np.empty(mesh.n_triangles + 1, np.int64)
    count_samples(owners, heights, starts)
    few = heights.size <= np.iinfo(np.int32).max
    samples = np.empty(starts[-1], np.int32 if few else np.int64)
    list_samples(owners, heights, starts, samples)
    return _Samples(grid, places, mesh.triangles, starts, samples, allowed)


def _least_squares(samples: _Samples, given: _Heights) -> tuple[_Heights, _Mask, float]:
    """Return heights of least squares, which vertices may move, and the sum of squares before."""
    from rtin._kernels.fitting import step_down

    heights = given.copy()
    sums, before, _ = _sums(samples, heights, 0.0)
    free = _free(samples, sums)
    step_down(samples.triangles, sums, free, _EXACTLY, _MOST_ROUNDS, heights)
    return heights, free, before


def _pressed(samples: _Samples, free: _Mask, heights: _Heights) -> _Heights:
    """Return heights within the tolerance, or nearly so: those near to what is beyond it change."""
    from rtin._kernels.fitting import step_down

    every = np.ones(len(samples.triangles), np.bool_)
    surface = (samples.places, heights, samples.triangles)
    off = triangles_off(*surface, samples.grid, samples.allowed, every)
    if not off.any():
        return heights
    near, vertices, movable = _part(samples, off)
    movable, pressed = movable & free[vertices], heights[vertices]
    for stiffness in _STIFFNESSES:
        sums, _, n_beyond = _sums(near, pressed, stiffness)
        if n_beyond == 0:
            break
        step_down(near.triangles, sums, movable, _ROUGHLY, _MOST_ROUNDS, pressed)
    heights = heights.copy()
    heights[vertices] = pressed
    return heights


def _part(samples: _Samples, chosen: _Mask) -> tuple[_Samples, _Numbers, _Mask]:
    """Return the triangles near the chosen ones as a mesh of their own.

    With it come the numbers that its vertices had, and which of them have all their triangles here.
    """
    reached = np.zeros(len(samples.places), np.bool_)
    reached[samples.triangles[chosen]] = True
    for _ in range(_RINGS):
        reached[samples.triangles[_around(samples.triangles, reached)]] = True
    near = np.flatnonzero(_around(samples.triangles, reached))
    taken = np.zeros(len(samples.places), np.bool_)
    taken[samples.triangles[near]] = True
    vertices, number = np.flatnonzero(taken), np.cumsum(taken, dtype=np.int32) - 1
    first, counts = samples.starts[near], np.diff(samples.starts)[near]
    starts = np.concatenate([[0], np.cumsum(counts)])
    places = np.repeat(first - starts[:-1], counts) + np.arange(starts[-1])
    part = replace(
        samples,
        places=samples.places[vertices],
        triangles=number[samples.triangles[near]],
        starts=starts,
        samples=samples.samples[places],
    )
    return part, vertices, reached[vertices]


def _around(triangles: NDArray[np.int32], marked: _Mask) -> _Mask:
    """Return which triangles have a marked vertex."""
    return np.asarray(marked[triangles[:, 0]] | marked[triangles[:, 1]] | marked[triangles[:, 2]])


def _sums(
    samples: _Samples, heights: _Heights, stiffness: float
) -> tuple[NDArray[np.float64], float, int]:
    """Return the sums of each triangle, all squared errors, and how many samples are too far."""
    from rtin._kernels.fitting import sum_samples

    n_triangles = len(samples.triangles)
    sums = np.empty((n_triangles, 9))
    before = (samples.places, heights, samples.triangles)
    after = (samples.starts, samples.samples, samples.grid.heights, samples.allowed)
    tasks = [
        (*before, *band, *after, float(stiffness), sums)
        for band in _parallel.row_bands(n_triangles)
    ]
    parts = _parallel.run(sum_samples, tasks)
    return sums, sum(total for total, _ in parts), sum(n_beyond for _, n_beyond in parts)


def _free(samples: _Samples, sums: NDArray[np.float64]) -> _Mask:
    """Return which vertices may move."""
    from rtin._kernels.fitting import gather, pin_exact

    squared_weights, pull = np.zeros((2, len(samples.places)))
    gather(samples.triangles, sums, squared_weights, pull)
    free = np.asarray(squared_weights >= _DETERMINED)
    if (samples.allowed == 0.0).any():
        lists = (samples.starts, samples.samples)
        n_cols = samples.grid.shape[1]
        pin_exact(samples.places, samples.triangles, *lists, n_cols, samples.allowed, free)
    return free


def _brought_back(samples: _Samples, given: _Heights, wished: _Heights) -> _Heights:
    """Return heights between the given and the wished ones, within the tolerance.

    Around each triangle that is off, vertices go halfway back, and after some rounds all the way.
    Every round brings some vertex nearer to where it was: with all of them there it would be over.
    """
    triangles = samples.triangles
    heights, share = wished, np.ones(len(given))
    wanted = np.ones(len(triangles), np.bool_)
    for factor in chain(repeat(0.5, _HALVINGS), repeat(0.0)):
        surface = (samples.places, heights, triangles)
        off = triangles_off(*surface, samples.grid, samples.allowed, wanted)
        moved = np.zeros(len(given), np.bool_)
        moved[triangles[off]] = True
        moved &= share > 0.0
        if not moved.any():
            break
        share[moved] *= factor
        heights = np.where(moved, given + share * (wished - given), heights)
        wanted = _around(triangles, moved)
    return heights


# --- the door -----------------------------------------------------------------------------------


def _require_within(mesh: TriangleMesh, grid: Grid, allowed: _Tolerance) -> None:
    """Raise ValueError where a mesh covers nothing, or is beyond the tolerance somewhere."""
    error = vertical_error(mesh, grid)
    if error.max <= allowed.min():
        return
    excess = np.abs(error.field) - allowed
    excess[np.isnan(excess)] = -np.inf
    row, col = np.unravel_index(excess.argmax(), grid.shape)
    if excess[row, col] > _ROUNDING * np.spacing(np.nanmax(np.abs(grid.heights)).astype(float)):
        raise ValueError(
            "max_error must be what the mesh keeps already, got "
            f"{np.broadcast_to(allowed, grid.shape)[row, col]:.6g} at row {row}, column {col}, "
            f"where the mesh is {abs(error.field[row, col]):.6g} off"
        )
