"""Coarsening: from a raster to a right-triangulated irregular network (RTIN) of few triangles.

Four families of meshes, told apart by what they promise:

``max_error``
    the least RTIN mesh in which every sample lies within the tolerance of its triangle;
``max_vertices``, ``max_triangles``
    the mesh of the smallest such tolerance that fits a budget;
``weight``, and those two with ``norm="rms"``
    the mesh of the least sum of squared errors, for what a vertex may cost or within a budget;
``threshold``, ``removable``
    the paper's: vertices marked for removal, by Eq. (1) or by the caller, are removed as far as a
    conforming mesh allows (algorithm RTIN-Coarsening of Suárez and Plaza, "Four-triangles adaptive
    algorithms for RTIN terrain meshes").

The RTIN meshes of a lattice are exactly the *closed* sets of its vertices: each kept vertex keeps
its parents, the apexes of the triangles that share the edge it bisects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin import _parallel, squared_error
from rtin._options import (
    MOST,
    as_count,
    as_height,
    as_tolerance_map,
    as_zero_or_more,
    require_word,
    the_only_option,
)
from rtin._raster import NO_TRIANGLE
from rtin.fitting import fitted
from rtin.grid import Grid, lattice_size, require_grid
from rtin.mesh import TriangleMesh

__all__ = ["coarsen", "coarsen_levels", "is_compiled"]

_Kept = NDArray[np.uint8]
_Swapped = NDArray[np.uint8] | None
_Items = NDArray[np.int64]
_Mask = NDArray[np.bool_]
_Shares = list[NDArray[np.int64]]  # work for each band of rows
_Tolerance = tuple[float, NDArray[np.float64] | None]

_COARSE_PARTS = 32
_NO_LIMIT: _Tolerance = (np.inf, None)
_OPTIONS_OF = {
    "max": ("max_error", "max_vertices", "max_triangles", "threshold", "removable"),
    "rms": ("max_vertices", "max_triangles", "weight"),
}
_MOST_NUMBERS = np.iinfo(np.int32).max


def coarsen(
    grid: Grid,
    *,
    max_error: float | ArrayLike | None = None,
    max_vertices: int | None = None,
    max_triangles: int | None = None,
    threshold: float | None = None,
    removable: ArrayLike | None = None,
    weight: float | None = None,
    keep: ArrayLike | None = None,
    norm: Literal["max", "rms"] = "max",
    diagonals: Literal["lattice", "best"] = "lattice",
    heights: Literal["sampled", "fitted"] = "sampled",
) -> TriangleMesh:
    """Return a conforming right-triangulated mesh of a grid, with vertices at samples.

    Exactly one of the first five options says what is removed; with ``norm="rms"`` it is exactly
    one of ``max_vertices``, ``max_triangles`` and ``weight``.

    Parameters
    ----------
    grid : Grid
        Heights of any shape from 2 × 2 samples on. The mesh covers exactly the finest triangles
        (half cells of the lattice) whose three samples have a height.
    max_error : float or array_like, shape (rows, cols)
        The least mesh in which every valid sample lies within this vertical distance of the
        surface, in the unit of the heights; equality is allowed, and so is 0 (the lossless mesh).
        *Guaranteed* for the mesh returned, everywhere on the surface; no RTIN mesh that keeps the
        promise has fewer vertices. Float64 heights that float32 can't hold may exceed it by a few
        units in their last place. An array gives each sample its own tolerance.
    max_vertices, max_triangles : int
        The mesh of the smallest ``max_error`` that has no more vertices or triangles than this.
        ``vertical_error(mesh, grid).max`` is the tolerance achieved.
    threshold : float
        The paper's criterion: vertices with E(v) < threshold (``vertex_errors``) are removed where
        the mesh stays conforming. *No promise on the surface*: Eq. (1) is local, and the largest
        error on real terrain is up to 2.3 times the threshold.
    removable : array_like of bool, shape (rows, cols)
        The paper's matrix C: True where a vertex is to be removed if the mesh stays conforming.
    weight : float
        Only with ``norm="rms"``: by how much the sum of squared vertical errors must fall for
        another vertex, in the square of the heights' unit. Of all RTIN meshes of the grid, the one
        with the least SSE + weight * vertices, of several such the smallest: exactly, up to the
        rounding of float64 sums. SSE counts every valid sample under the mesh once. 0 is the
        lossless mesh.
    keep : array_like of bool, shape (rows, cols), optional
        Vertices to keep whatever the criterion says: peaks, ridges, coastlines. Samples without a
        height, and those of which no finest triangle is whole, can't be kept.
    norm : {"max", "rms"}
        What a budget makes small: the largest error, or the root of the mean square. With "rms" it
        gets the largest mesh that fits of those that are best for some ``weight``: no RTIN mesh of
        as many vertices, sampled and on the lattice's diagonals, has a smaller rms. There is one
        for almost every number of vertices on real terrain; what room is left is filled greedily,
        by the largest gain per vertex, and that is *not* guaranteed to be the best. Nothing is
        promised on the largest error.
    diagonals : {"lattice", "best"}, optional
        Where two triangles share their hypotenuse they make a square, upright or rotated by 45
        degrees, and may share its other diagonal instead. "lattice" never does that. "best" does it
        for each square by itself, in the wider family of meshes that this makes:

        - ``max_error``: the promise is the same, and no mesh of the wider family that keeps it has
          fewer vertices; they are among those of the "lattice" mesh.
        - ``max_vertices``, ``max_triangles``: the mesh of the smallest such ``max_error``.
        - ``threshold``, ``removable``, and all with ``norm="rms"``: the "lattice" mesh's vertices.

        Of the diagonals within the tolerance (both, where there is none) each square then has the
        one with the smaller sum of squared errors at its samples, the lattice's where they are
        equal. *Not promised*: a smaller largest error than with "lattice" for ``threshold``,
        ``removable`` and ``norm="rms"``, and the least squared error over all meshes of as many
        vertices. On real terrain a budget with ``norm="max"`` often has the smaller rms as well.
    heights : {"sampled", "fitted"}
        Where the vertices chosen lie. Sampled: at the raster's heights, unchanged. Fitted: moved
        up or down for the smallest sum of squared errors over all samples, as ``fit_heights``
        does. ``max_error`` is kept all the same; where none is promised, which includes budgets,
        the largest error may rise.

    Returns
    -------
    TriangleMesh
        Vertices in row-major order of their samples, with the raster's heights unchanged unless
        they are fitted; triangles counter-clockwise from above, their hypotenuse on the lattice
        first, in row-major order of their apexes; those of a square on its other diagonal stand
        where the two others would, each turned by a quarter about the square's middle. The same
        bytes on any number of threads.

    Raises
    ------
    TypeError
        If ``grid`` is not a Grid, or an option is of the wrong kind.
    ValueError
        If none or several of the options are given, or one that does not go with the norm;
        ``norm``, ``diagonals`` or ``heights`` is another word; a tolerance or weight is negative,
        or NaN where there is a height; an array is not of the grid's shape; a budget is too small
        for the grid's outline; or the grid has no finest triangle with three heights.
    MemoryError
        If the lattice does not fit in memory.
    """
    require_grid(grid)
    require_word("norm", norm, _OPTIONS_OF)
    require_word("diagonals", diagonals, ("lattice", "best"))
    require_word("heights", heights, ("sampled", "fitted"))
    name, value = _asked(
        norm,
        max_error=max_error,
        max_vertices=max_vertices,
        max_triangles=max_triangles,
        threshold=threshold,
        removable=removable,
        weight=weight,
    )
    required = None if keep is None else _as_mask(grid, "keep", keep)
    swapped = lattice_bytes(lattice_size(grid.shape)) if diagonals == "best" else None
    tolerance = _NO_LIMIT
    if name == "max_error":
        tolerance = _as_tolerance(grid, value)
        kept = _least_mesh(grid, tolerance, required, swapped)
    elif name == "threshold":
        kept = _above_threshold(grid, as_height("threshold", value), required)
    elif name == "removable":
        kept = _unmarked(grid, _as_mask(grid, "removable", value), required)
    elif name == "weight":
        weight = as_zero_or_more(name, value, "in squares of the raster's height units")
        kept = _least_squares(grid, weight, required)
    elif norm == "rms":
        kept = _least_squares_within_budget(grid, name, as_count(name, value), required)
    else:
        kept, tolerance = _within_budget(grid, name, as_count(name, value), required, swapped)
    _choose_diagonals(grid, kept, swapped, tolerance)
    mesh = mesh_of_kept(grid, kept, swapped)
    if heights == "sampled":
        return mesh
    return _fitted(mesh, grid, tolerance if name == "max_error" else _NO_LIMIT)


def coarsen_levels(
    grid: Grid, max_errors: Sequence[float], *, keep: ArrayLike | None = None
) -> list[TriangleMesh]:
    """Return the least mesh for each of several tolerances, in the order given.

    Each mesh equals ``coarsen(grid, max_error=...)`` for its tolerance. They are nested: the
    vertices of a coarser one are among those of a finer one. Every mesh starts from the triangles
    of the next coarser one, which spares the tests of all larger triangles.

    Parameters
    ----------
    grid : Grid
    max_errors : sequence of float
        Tolerances in the unit of the heights, in any order.
    keep : array_like of bool, shape (rows, cols), optional
        Vertices that every mesh keeps.

    Raises
    ------
    TypeError, ValueError, MemoryError
        As ``coarsen`` does; ValueError if there is no tolerance at all.
    """
    require_grid(grid)
    if np.ndim(max_errors) != 1:
        raise TypeError(f"max_errors must be a sequence of numbers, got {max_errors!r}")
    tolerances = [as_height("max_errors", value) for value in max_errors]
    if not tolerances:
        raise ValueError("max_errors must hold at least one tolerance, got an empty sequence")
    required = None if keep is None else _as_mask(grid, "keep", keep)
    kept, meshes = _coarsest(grid), {}
    starts: Iterable[_Shares] = _starts(grid, required)
    for tolerance in sorted(set(tolerances), reverse=True):
        remembers = tolerance > min(tolerances)
        starts = [_settle(grid, kept, shares, (tolerance, None), remembers) for shares in starts]
        meshes[tolerance] = mesh_of_kept(grid, kept)
    return [meshes[tolerance] for tolerance in tolerances]


def is_compiled() -> bool:
    """Return whether compiled kernels lie on disk: the first call on a machine takes longer."""
    from rtin._kernels._jit import compiled_before
    from rtin._kernels.coarsening import fill_triangles

    return compiled_before(fill_triangles)


# --- the families -------------------------------------------------------------------------------


def _least_mesh(
    grid: Grid, tolerance: _Tolerance, required: _Mask | None, swapped: _Swapped = None
) -> _Kept:
    kept = _coarsest(grid)
    for shares in _starts(grid, required):
        _settle(grid, kept, shares, tolerance, swapped=swapped)
    return kept


def _above_threshold(grid: Grid, threshold: float, required: _Mask | None) -> _Kept:
    from rtin._kernels.coarsening import close_all, keep_by_threshold

    kept = _outline(grid)
    common = (grid.heights, lattice_size(grid.shape), threshold, kept)
    bands = _parallel.row_bands(len(kept))
    close_all(kept, _joined(_parallel.run(keep_by_threshold, [(*common, *band) for band in bands])))
    _keep_marked(grid, kept, required)
    return kept


def _unmarked(grid: Grid, removable: _Mask, required: _Mask | None) -> _Kept:
    kept = _outline(grid)
    _keep_marked(grid, kept, ~removable)
    _keep_marked(grid, kept, required)
    return kept


def _within_budget(
    grid: Grid, name: str, budget: int, required: _Mask | None, swapped: _Swapped
) -> tuple[_Kept, _Tolerance]:
    """Return the closed set of a budget's mesh, and the tolerance of which it is the least one."""
    from rtin._kernels.coarsening import split_worst_first
    from rtin._kernels.lattice import VERTEX, pack

    kept = _least_mesh(grid, _NO_LIMIT, required)
    n_vertices, n_triangles = _size(grid, kept)
    limits = _limits(name, budget, n_vertices, n_triangles)
    rows, cols = np.nonzero(kept[: grid.shape[0], : grid.shape[1]])
    items = pack(rows, cols, VERTEX)
    reached = split_worst_first(
        grid.heights, kept, swapped, items, n_vertices, n_triangles, *limits
    )
    return kept, (reached, None)


def _least_squares(grid: Grid, weight: float, required: _Mask | None) -> _Kept:
    if weight == 0.0:  # no error is worth a vertex less
        return _least_mesh(grid, (0.0, None), required)
    kept = _least_mesh(grid, _NO_LIMIT, required)
    squared_error.keep_best(squared_error.vertex_gains(grid), kept, weight)
    return kept


def _least_squares_within_budget(
    grid: Grid, name: str, budget: int, required: _Mask | None
) -> _Kept:
    kept = _least_mesh(grid, _NO_LIMIT, required)
    size = _size(grid, kept)
    limits = _limits(name, budget, *size)
    gains = squared_error.vertex_gains(grid)
    room = np.subtract(limits, size)
    if squared_error.may_hold_all(gains, kept, room):
        lossless = _least_mesh(grid, (0.0, None), required)
        if all(np.less_equal(_size(grid, lossless), limits)):
            return lossless
    squared_error.keep_within(gains, kept, room)
    return kept


def _limits(name: str, budget: int, n_vertices: int, n_triangles: int) -> tuple[int, int]:
    """Return the most vertices and triangles within a budget; refuse one below the least mesh."""
    least = n_vertices if name == "max_vertices" else n_triangles
    if budget < least:
        raise ValueError(
            f"{name} must be at least {least} for this outline and what is to keep, got {budget}"
        )
    return (budget, MOST) if name == "max_vertices" else (MOST, budget)


# --- the two rules ------------------------------------------------------------------------------


def _settle(
    grid: Grid,
    kept: _Kept,
    shares: _Shares,
    tolerance: _Tolerance,
    remembers: bool = False,
    swapped: _Swapped = None,
) -> _Shares:
    """Keep what the work in ``shares`` and both rules of the least mesh demand.

    Each band of rows is settled by itself; what it needs of other rows is their next round's work.
    Returns the triangles that were found to fit, if it is to remember them: those still whole are
    all that a smaller tolerance has to test.
    """
    from rtin._kernels.coarsening import settle

    n_rows = len(kept)
    bands = _parallel.row_bands(n_rows)
    common = (grid.heights, is_complete(grid), *tolerance, kept, swapped)
    found = [[share[:0]] for share in shares]
    if sum(share.size for share in shares) < len(bands):
        # Too little to share out: the largest triangles first, whose splits are everybody's work.
        finest = (n_rows - 1) // _COARSE_PARTS
        _, work, fitting = settle(*common, 0, n_rows, finest, remembers, _joined(shares))
        found = [[share] for share in _shared_out(fitting, bands)]
        shares = _shared_out(work, bands)
    while any(share.size for share in shares):
        busy = [number for number, share in enumerate(shares) if share.size]
        tasks = [(*common, *bands[number], 1, remembers, shares[number]) for number in busy]
        results = _parallel.run(settle, tasks)
        for number, (_, _, fitting) in zip(busy, results, strict=True):
            found[number].append(fitting)
        shares = _shared_out(_joined(elsewhere for elsewhere, _, _ in results), bands)
    return [_joined(parts) for parts in found]


def _keep_marked(grid: Grid, kept: _Kept, mask: _Mask | None) -> None:
    """Keep the vertices of a mask that have a height, and all that the closure adds."""
    from rtin._kernels.coarsening import close_all, keep_by_mask

    if mask is not None:
        mask = mask & ~np.isnan(grid.heights)
        bands = _parallel.row_bands(len(kept))
        close_all(
            kept, _joined(_parallel.run(keep_by_mask, [(mask, kept, *band) for band in bands]))
        )


# --- diagonals ----------------------------------------------------------------------------------


def _choose_diagonals(grid: Grid, kept: _Kept, swapped: _Swapped, tolerance: _Tolerance) -> None:
    """Swap the squares that fit on both diagonals and have less squared error on the other one."""
    from rtin._kernels.diagonals import choose_diagonals

    if swapped is not None:
        shared = (grid.heights, *tolerance, kept, _words(kept), swapped)
        bands = _parallel.row_bands(grid.shape[0])
        _parallel.run(choose_diagonals, [(*shared, *band) for band in bands])


# --- heights -------------------------------------------------------------------------------------


def _fitted(mesh: TriangleMesh, grid: Grid, tolerance: _Tolerance) -> TriangleMesh:
    number, of_samples = tolerance
    return fitted(mesh, grid, np.array([[number]]) if of_samples is None else of_samples)


# --- the mesh of a closed set -------------------------------------------------------------------


def mesh_of_kept(grid: Grid, kept: _Kept, swapped: _Swapped = None) -> TriangleMesh:
    from rtin._kernels.coarsening import fill_triangles, fill_vertices

    in_mesh = _mark_used(grid, kept)
    vertex_counts, triangle_counts = _counts(grid, kept, in_mesh)
    first_vertex, n_vertices = _offsets(vertex_counts)
    first_triangle, n_triangles = _offsets(triangle_counts)
    if n_triangles == 0:
        raise ValueError(NO_TRIANGLE)
    if max(n_vertices, n_triangles) > _MOST_NUMBERS:
        raise ValueError(
            f"the mesh would have {n_vertices} vertices and {n_triangles} triangles, more than "
            f"{_MOST_NUMBERS}; allow a larger error, or coarsen windows of the raster"
        )
    vertices = np.empty((n_vertices, 3), np.float64)
    triangles = np.empty((n_triangles, 3), np.int32)
    words = _words(kept)
    first_in_word = np.empty(words.shape, np.int32)
    transform = np.array(tuple(grid.transform)[:6], np.float64)
    flip = grid.transform.determinant > 0.0
    shared = (grid.heights, kept, words, in_mesh)
    bands = _parallel.row_bands(grid.shape[0])
    outputs: tuple[Any, ...] = (first_vertex, first_in_word, vertices)
    _parallel.run(fill_vertices, [(*shared, transform, *band, *outputs) for band in bands])
    outputs = (first_triangle, first_in_word, flip, triangles)
    _parallel.run(fill_triangles, [(*shared, swapped, *band, *outputs) for band in bands])
    return TriangleMesh(vertices, triangles, grid.crs)


def _mark_used(grid: Grid, kept: _Kept) -> int:
    """Mark which kept vertices have a triangle; return the byte that says so."""
    from rtin._kernels.coarsening import KEPT, USED, mark_used

    if is_complete(grid):
        return KEPT
    mark_used(grid.heights, kept, _words(kept))
    return USED


def _counts(grid: Grid, kept: _Kept, in_mesh: int) -> tuple[_Items, _Items]:
    """Return the number of vertices in each row, and of triangles whose apex lies there."""
    from rtin._kernels.coarsening import count_mesh

    rows = grid.shape[0]
    n_vertices, n_triangles = np.empty(rows, np.int64), np.empty(rows, np.int64)
    shared = (grid.heights, kept, _words(kept), in_mesh)
    bands = _parallel.row_bands(rows)
    _parallel.run(count_mesh, [(*shared, *band, n_vertices, n_triangles) for band in bands])
    return n_vertices, n_triangles


def _size(grid: Grid, kept: _Kept) -> tuple[int, int]:
    """Return the number of vertices and triangles of a closed set's mesh."""
    n_vertices, n_triangles = _counts(grid, kept, _mark_used(grid, kept))
    return int(n_vertices.sum()), int(n_triangles.sum())


def _offsets(counts: _Items) -> tuple[_Items, int]:
    ends = np.cumsum(counts)
    return ends - counts, int(ends[-1])


# --- the lattice --------------------------------------------------------------------------------


def is_complete(grid: Grid) -> bool:
    """Return whether the grid fills its lattice: square, 2**k + 1 samples a side, no voids."""
    size = lattice_size(grid.shape)
    return grid.shape == (size + 1, size + 1) and not grid.has_voids


def _coarsest(grid: Grid) -> _Kept:
    """Return the closed set of the two root triangles: the lattice's corners."""
    size = lattice_size(grid.shape)
    kept = lattice_bytes(size)
    kept[::size, : size + 1 : size] = 1
    return kept


def lattice_bytes(size: int) -> _Kept:
    """Return a zero for each sample of a lattice of ``size`` cells a side."""
    try:
        # Rows are padded so that they can be read by eights as well.
        return np.zeros((size + 1, 8 * (size // 8 + 2)), np.uint8)
    except (MemoryError, ValueError):
        raise MemoryError(
            f"a lattice of {size + 1} × {size + 1} samples needs {(size + 1) ** 2 / 2**30:.1f} "
            "GiB, which can't be had; coarsen windows of the grid instead"
        ) from None


def _words(kept: _Kept) -> NDArray[np.uint64]:
    """Return the same bytes, eight at a time."""
    return kept.view(np.uint64)


def _outline(grid: Grid) -> _Kept:
    """Return the least closed set that separates heights from voids."""
    return _coarsest(grid) if is_complete(grid) else _least_mesh(grid, _NO_LIMIT, None)


def _starts(grid: Grid, required: _Mask | None) -> Iterator[_Shares]:
    """Yield what a mesh is grown from: the two root triangles, then the required vertices.

    Where many are required, settling a band of them at a time bounds the memory.
    """
    from rtin._kernels.lattice import VERTEX, pack

    size = lattice_size(grid.shape)
    bands = _parallel.row_bands(size + 1)
    # The roots' apexes are the corners in the north-east and the south-west.
    roots = [pack(0, size, 2), pack(size, 0, 1)] if size > 1 else []
    yield _shared_out(np.array(roots, np.int64), bands)
    if required is not None:
        for first, end in _parallel.row_bands(grid.shape[0]):
            rows, cols = np.nonzero(required[first:end] & ~np.isnan(grid.heights[first:end]))
            yield _shared_out(pack(rows + first, cols, VERTEX), bands)


def _joined(parts: Iterable[_Items]) -> _Items:
    return np.concatenate(list(parts))


def _shared_out(work: _Items, bands: list[tuple[int, int]]) -> _Shares:
    """Return the work of each band of rows."""
    from rtin._kernels.lattice import rows_of

    ends = np.array([end for _, end in bands])
    band_of = np.searchsorted(ends, rows_of(work), side="right")
    order = np.argsort(band_of, kind="stable")
    return np.split(work[order], np.cumsum(np.bincount(band_of, minlength=len(bands)))[:-1])


# --- the door -----------------------------------------------------------------------------------


def _asked(norm: str, **options: Any) -> tuple[str, Any]:  # noqa: ANN401
    """Return name and value of the one option given, of those that go with the norm."""
    fitting = {name: options.pop(name) for name in _OPTIONS_OF[norm]}
    foreign = [name for name, value in options.items() if value is not None]
    if foreign:
        raise ValueError(
            f"{foreign[0]} does not go with norm={norm!r}; give exactly one of {', '.join(fitting)}"
        )
    return the_only_option(**fitting)


def _as_tolerance(grid: Grid, value: Any) -> _Tolerance:  # noqa: ANN401
    """Return a tolerance as the kernels take it: one number, or one for each sample."""
    if np.ndim(value) == 0:
        return as_height("max_error", value), None
    return 0.0, as_tolerance_map(grid, "max_error", value)


def _as_mask(grid: Grid, name: str, value: ArrayLike) -> _Mask:
    mask = np.asarray(value)
    if mask.dtype != np.bool_:
        raise TypeError(f"{name} must be an array of booleans, got one of {mask.dtype}")
    if mask.shape != grid.shape:
        raise ValueError(f"{name} must have the grid's shape {grid.shape}, got {mask.shape}")
    return mask
