"""Error criteria: what a vertex is worth, and how far a mesh is from its raster.

``vertex_errors`` is Eq. (1) of Suárez and Plaza, "Four-triangles adaptive algorithms for RTIN
terrain meshes". ``vertical_error`` measures what a mesh achieves, whatever made it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray

from rtin import _parallel
from rtin.grid import Grid, lattice_size, places_in, require_grid
from rtin.mesh import TriangleMesh, require_mesh

__all__ = ["ErrorFigures", "VerticalError", "vertex_errors", "vertical_error"]


def vertex_errors(heights: ArrayLike | Grid) -> NDArray[np.float32]:
    """Return E(v) of Eq. (1) for every sample, on its own level of the hierarchy.

    E(v) = abs((h(a) + h(b)) / 2 - h(v)), a and b being the ends of the longest edge whose midpoint
    is v: how far v is from the surface of the mesh one bisection before v.

    Parameters
    ----------
    heights : array_like, shape (rows, cols), or Grid
        Any shape from 2 × 2 on; the raster lies in the north-west corner of its lattice.

    Returns
    -------
    ndarray of float32, shape (rows, cols)
        In the unit of the heights, computed in float64 and rounded once. The lattice's corners,
        and vertices whose a or b has no height, are inf: they can't be removed. Samples without a
        height are NaN.

    Raises
    ------
    TypeError, ValueError
        As ``Grid`` does.
    """
    from rtin._kernels.criteria import fill_errors

    grid = heights if isinstance(heights, Grid) else Grid(heights)
    errors = np.empty(grid.shape, np.float32)
    size = lattice_size(grid.shape)
    tasks = [(grid.heights, size, *band, errors) for band in _parallel.row_bands(grid.shape[0])]
    _parallel.run(fill_errors, tasks)
    if grid.has_voids:
        errors[np.isnan(errors)] = np.inf
        errors[np.isnan(grid.heights)] = np.nan
    return errors


@dataclass(frozen=True)
class ErrorFigures:
    """How far a mesh is from a raster, measured upright at every valid sample.

    Attributes
    ----------
    max, rms, mean : float
        Of abs(surface - sample), in the unit of the heights.
    sample : (int, int)
        Row and column of the first sample, in row-major order, where the largest error is.
    n_samples : int
        Valid samples that the mesh covers.
    n_uncovered : int
        Valid samples without any surface above or below; they enter no figure.
    """

    max: float
    rms: float
    mean: float
    sample: tuple[int, int]
    n_samples: int
    n_uncovered: int


@dataclass(frozen=True)
class VerticalError(ErrorFigures):
    """How far a mesh is from a grid: the figures, and a map.

    Attributes
    ----------
    max, rms, mean, sample, n_samples, n_uncovered
        As in ``ErrorFigures``: of abs(surface - sample) at every valid sample.
    field : ndarray of float64, shape (rows, cols)
        surface - sample, computed when first asked for; NaN where there is no sample or no surface.
    """

    _mesh: TriangleMesh
    _grid: Grid

    @cached_property
    def field(self) -> NDArray[np.float64]:
        """The whole map of surface - sample, float64 of shape (rows, cols)."""
        surface = surface_at_samples(self._mesh, self._grid.transform, self._grid.shape)
        return surface - self._grid.heights

    def __repr__(self) -> str:
        return (
            f"<VerticalError max {self.max:.6g} at row {self.sample[0]}, column {self.sample[1]}; "
            f"rms {self.rms:.6g}, mean {self.mean:.6g} over {self.n_samples} samples, "
            f"{self.n_uncovered} uncovered>"
        )


def vertical_error(mesh: TriangleMesh, grid: Grid) -> VerticalError:
    """Return how far a mesh is from a raster at every valid sample.

    The mesh may come from anywhere, as long as it lies in the grid's coordinates and is a surface
    over the plane (where triangles overlap, one of them counts). Vertices closer than a millionth
    of a cell to a sample's place are taken to be at it. All arithmetic is float64; for meshes
    coarsened from the grid nothing but the last bits of very unlike heights is ever rounded.

    Raises
    ------
    TypeError
        If ``mesh`` is not a TriangleMesh or ``grid`` not a Grid.
    ValueError
        If the mesh covers no valid sample: it lies elsewhere.
    """
    require_grid(grid)
    require_mesh(mesh)
    bands = _bands_of(mesh, grid.transform, grid.heights)
    parts = _parallel.run(_statistics_of_band, bands)
    return VerticalError(**_figures(parts), _mesh=mesh, _grid=grid)


def surface_at_samples(
    mesh: TriangleMesh, transform: Affine, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Return a mesh's height at each sample of a lattice, of that shape; NaN where it has none."""
    lattice = np.broadcast_to(np.float64(0.0), shape)
    surfaces = _parallel.run(_surface_of_band, _bands_of(mesh, transform, lattice))
    return np.concatenate(surfaces)


def error_by_bands(
    mesh: TriangleMesh,
    transform: Affine,
    rows: list[tuple[int, int]],
    read: Callable[[int, int], NDArray[np.floating[Any]]],
) -> ErrorFigures:
    """Return the figures of ``vertical_error`` for a raster of which no more than bands are read.

    ``rows`` are the first row of each band and the one after its last; ``read`` returns the heights
    between these, and is called by one thread, for as many bands at a time as there are threads.
    """
    places, z = (
        places_in(transform, mesh.vertices[:, :2]),
        np.ascontiguousarray(mesh.vertices[:, 2]),
    )
    bands = members_by_band(places, mesh.triangles, rows)
    step, parts = _parallel.thread_count(), []
    for i in range(0, len(bands), step):
        group = [
            (_Band(first, read(first, end), places, z, mesh.triangles, members),)
            for first, end, members in bands[i : i + step]
        ]
        parts += _parallel.run(_statistics_of_band, group)
    return ErrorFigures(**_figures(parts))


def _figures(parts: list[tuple[Any, ...]]) -> dict[str, Any]:
    """Return the attributes of ``ErrorFigures`` of a raster, from statistics of its bands."""
    n_samples, n_uncovered = (sum(part[i] for part in parts) for i in (0, 1))
    total, total_of_squares = (sum(part[i] for part in parts) for i in (2, 3))
    worst = max(parts, key=lambda part: part[4])
    if n_samples == 0:
        raise ValueError(
            "the mesh covers no sample of the grid; bring both into the same coordinates"
        )
    return {
        "max": float(worst[4]),
        "rms": float(np.sqrt(total_of_squares / n_samples)),
        "mean": float(total / n_samples),
        "sample": (int(worst[5]), int(worst[6])),
        "n_samples": n_samples,
        "n_uncovered": n_uncovered,
    }


@dataclass(frozen=True)
class _Band:
    """Some rows of a grid, and the triangles of a mesh that reach into them."""

    first_row: int
    heights: NDArray[np.floating[Any]]
    places: NDArray[np.float64]  # row and column of each vertex
    z: NDArray[np.float64]
    triangles: NDArray[np.int32]
    members: NDArray[np.int32]


def _bands_of(
    mesh: TriangleMesh, transform: Affine, heights: NDArray[np.floating[Any]]
) -> list[tuple[_Band]]:
    places, z = (
        places_in(transform, mesh.vertices[:, :2]),
        np.ascontiguousarray(mesh.vertices[:, 2]),
    )
    rows = _parallel.row_bands(len(heights))
    return [
        (_Band(first, heights[first:end], places, z, mesh.triangles, members),)
        for first, end, members in members_by_band(places, mesh.triangles, rows)
    ]


def members_by_band(
    places: NDArray[np.float64], triangles: NDArray[np.int32], rows: list[tuple[int, int]]
) -> list[tuple[int, int, NDArray[np.int32]]]:
    """Return bands of rows: the first, the one after the last, and the triangles that reach in.

    The bands follow each other from row 0 to the last.
    """
    from rtin._kernels.criteria import count_by_band, fill_by_band

    band_of_row = np.repeat(np.arange(len(rows)), [end - first for first, end in rows])
    shares = _parallel.row_bands(len(triangles))
    common = [(places, triangles, *share, band_of_row) for share in shares]
    counts = np.zeros((len(shares), len(rows)), np.int64)
    _parallel.run(
        count_by_band, [(*task, count) for task, count in zip(common, counts, strict=True)]
    )
    # Band after band, and in each share after share: the order of the triangles.
    ends = np.cumsum(counts.T).reshape(counts.T.shape).T
    starts = ends - counts
    members = np.empty(counts.sum(), np.int32)
    first_of_band = [*starts[0].tolist(), len(members)]
    tasks = [(*task, start, members) for task, start in zip(common, starts, strict=True)]
    _parallel.run(fill_by_band, tasks)
    return [
        (*band, members[start:stop])
        for band, (start, stop) in zip(rows, pairwise(first_of_band), strict=True)
    ]


def triangles_off(
    places: NDArray[np.float64],
    z: NDArray[np.float64],
    triangles: NDArray[np.int32],
    grid: Grid,
    allowed: NDArray[np.float64],
    wanted: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Return which of the wanted triangles have a sample that is farther from them than allowed.

    ``places`` holds row and column of each vertex; ``allowed`` is of the raster's shape, or has
    one row and column for all samples.
    """
    from rtin._kernels.criteria import find_off

    off = wanted.copy()
    tasks = [
        (places, z, triangles, *band, grid.heights, allowed, off)
        for band in _parallel.row_bands(len(triangles))
    ]
    _parallel.run(find_off, tasks)
    return off


def _surface_of_band(band: _Band) -> NDArray[np.float64]:
    from rtin._kernels.criteria import fill_surface

    surface = np.full(band.heights.shape, np.nan)
    fill_surface(band.places, band.z, band.triangles, band.members, band.first_row, surface)
    return surface


def _statistics_of_band(band: _Band) -> tuple[Any, ...]:
    from rtin._kernels.criteria import error_statistics

    statistics: tuple[Any, ...] = error_statistics(
        band.heights, band.first_row, _surface_of_band(band)
    )
    return statistics
