"""The neighbours of triangles, for algorithms that walk over a mesh; only of a right mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtin import _parallel, validity
from rtin.mesh import TriangleMesh

__all__ = ["MOST_TRIANGLES", "require_numbers", "twins_of"]

_Numbers = NDArray[np.int32]

MOST_TRIANGLES = np.iinfo(np.int32).max // 3  # whose half-edges 32 bits can number


def require_numbers(n_triangles: int) -> None:
    """Raise ValueError where a refined mesh would have more triangles than can be numbered."""
    if n_triangles > MOST_TRIANGLES:
        raise ValueError(
            f"at most {MOST_TRIANGLES} triangles can be numbered, the refined mesh would have "
            f"{n_triangles}; mark fewer triangles"
        )


def twins_of(mesh: TriangleMesh) -> _Numbers:
    """Return the twin of each half-edge ``3 * triangle + side``, -1 on the boundary, shape (3m,).

    Raises
    ------
    InvalidMesh
        If ``mesh`` is no right mesh, as ``validity.check`` says, but vertices that belong to no
        triangle are let pass.
    ValueError
        If it has 2**31 / 3 triangles or more.
    """
    if mesh.n_triangles > MOST_TRIANGLES:
        raise ValueError(f"at most {MOST_TRIANGLES} triangles are wanted, got {mesh.n_triangles}")
    looks_right = np.isfinite(mesh.vertices).all() and _turns_left(mesh)
    twins = _paired(mesh) if looks_right else None
    if twins is None or validity.has_gaps(mesh, np.flatnonzero(twins < 0)):
        validity.check_triangles(mesh)
        twins = _paired(mesh)
    if twins is None:
        raise validity.InvalidMesh("an edge belongs to more than two triangles")
    return twins


def _turns_left(mesh: TriangleMesh) -> bool:
    from rtin._kernels.adjacency import all_turn_left

    bands = _parallel.row_bands(mesh.n_triangles)
    return all(_parallel.run(all_turn_left, [(mesh.vertices, mesh.triangles, *b) for b in bands]))


def _paired(mesh: TriangleMesh) -> _Numbers | None:
    """Return the twins, or None where an edge has more than one half-edge in a direction."""
    from rtin._kernels.adjacency import pair_edges

    twins = np.empty(3 * mesh.n_triangles, np.int32)
    waiting = np.empty((3 * mesh.n_triangles, 2), np.int32)
    latest = np.full(mesh.n_vertices, -1, np.int32)
    # Each task looks at all edges and keeps those of its vertices: no more tasks than threads.
    bands = _parallel.row_bands(mesh.n_vertices, most=_parallel.thread_count())
    tasks = [(mesh.triangles, *band, latest, waiting, twins) for band in bands]
    return twins if all(_parallel.run(pair_edges, tasks)) else None
