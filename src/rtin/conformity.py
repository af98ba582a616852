"""Conformity: how many triangles around a triangle have to be split to refine it.

The metrics M1 and M2 of Suárez and Plaza, "Four-triangles adaptive algorithms for RTIN terrain
meshes", section 2.1.2. Refining a triangle bisects its three edges; from each, a walk goes over the
longest edge of one triangle after the other, until two share theirs or the boundary is met.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin import _parallel
from rtin._adjacency import twins_of
from rtin.mesh import TriangleMesh, require_mesh
from rtin.refinement import require_triangles

__all__ = ["Propagation", "propagation"]


class Propagation(NamedTuple):
    """M1 and M2 of triangles.

    Attributes
    ----------
    m1 : ndarray of int32, shape (k,)
        The size of the conformity neighbourhood: how many other triangles are split if this one is
        refined.
    m2 : ndarray of int32, shape (k,)
        The number of triangles on the longest of the three walks.
    """

    m1: NDArray[np.int32]
    m2: NDArray[np.int32]


def propagation(mesh: TriangleMesh, triangles: ArrayLike | None = None) -> Propagation:
    """Return how far refining each triangle alone would propagate; nothing is refined.

    Parameters
    ----------
    mesh : TriangleMesh
        Conforming; vertices 0 and 1 of each triangle end its longest edge.
    triangles : array_like, optional
        Numbers of triangles, in any order; or a boolean for each. By default all of them.

    Returns
    -------
    Propagation
        ``m1`` and ``m2``, for each of ``triangles`` in their order. M1 is exactly the number of
        other triangles that ``refine`` splits for this target with 4T-LE or 4T-SS, M2 the largest
        number of triangles on one walk; the target itself never counts.

    Raises
    ------
    InvalidMesh
        If ``mesh`` is not conforming.
    IndexError, TypeError, ValueError
        If ``triangles`` are not as they should be.

    Notes
    -----
    The time grows with the sum of all walks: a few steps for each triangle of most meshes, but n²
    for a strip of n ever longer ones.
    """
    from rtin._kernels.conformity import fill_propagation

    require_mesh(mesh)
    if triangles is None:
        chosen = np.arange(mesh.n_triangles)
    else:
        chosen = require_triangles(triangles, mesh.n_triangles)
    twins = twins_of(mesh)
    m1, m2 = np.zeros((2, len(chosen)), np.int32)
    bands = _parallel.row_bands(len(chosen), most=_parallel.thread_count())
    tasks = [(twins, chosen[first:end], m1[first:end], m2[first:end]) for first, end in bands]
    _parallel.run(fill_propagation, tasks)
    return Propagation(m1, m2)
