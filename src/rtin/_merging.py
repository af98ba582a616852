"""Merging of vertices where a surface is flat, then Delaunay: the stand-in for Rational Reducer.

Suárez and Plaza, "Four-triangles adaptive algorithms for RTIN terrain meshes", compare their
algorithm with that program, which is closed source and no longer sold. All they say of it is: "When
the angle between the outside normal vectors for two adjacent triangles is very small then the
vertex points are combined to form one single vertex. This is performed by a recursive search …
(although steps are used to avoid flattening a sphere). RR uses a Delaunay approach to construct the
triangle meshes"; it is asked for a percentage to remove, and its vertices end up nearly even.

Here the vertices at the ends of an edge become one in its middle, the edges with the smallest
angle first. It is done in rounds: a vertex takes part in one merge of a round, and after each round
the triangles are Delaunay's of the vertices as they are then, and their angles are measured anew,
so that small angles don't add up to a flattened sphere. What a round may merge is a share of the
edges, so that no round goes on to large angles while there are smaller ones elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtin._edges import directed_edges, undirected_keys

__all__ = ["merge_flat"]

_Points = NDArray[np.float64]
_Numbers = NDArray[np.int64]
_Triangles = NDArray[np.int32]

_SHARE = 0.5  # of the edges, those with the smallest angles, that a round may merge


def merge_flat(
    points: _Points, triangles: _Triangles, max_vertices: int
) -> tuple[_Points, _Triangles]:
    """Return at most so many vertices, and their Delaunay triangles.

    The outline has to be a rectangle along the axes: its corners stay, and vertices on a side of it
    stay on that side. Equal angles are told apart by a fixed permutation of the edges, so that flat
    parts are thinned evenly; the same input gives the same bytes.

    Parameters
    ----------
    points : float64, shape (n, 3)
        In one unit for x, y and z.
    triangles : int32, shape (m, 3)
        Counter-clockwise from above. As they are if there are not more vertices than asked for.
    max_vertices : int
        4 or more.
    """
    while len(points) > max_vertices:
        merges = _choose(points, triangles, len(points) - max_vertices)
        points = _merged(points, merges)
        triangles = _delaunay(points)
    return points, triangles


def _choose(points: _Points, triangles: _Triangles, n_most: int) -> _Numbers:
    """Return the pairs of vertices that become one in this round, the one to stay first."""
    ends, angles = _angles(points, triangles)
    ends, angles = _stay_first(points, ends, angles)
    order = np.random.default_rng(0).permutation(len(ends))
    order = order[np.argsort(angles[order], kind="stable")]
    taken = bytearray(len(points))
    chosen: list[tuple[int, int]] = []
    for a, b in ends[order[: max(1, int(_SHARE * len(order)))]].tolist():
        if not (taken[a] or taken[b]):
            taken[a] = taken[b] = 1
            chosen.append((a, b))
    return np.array(chosen[:n_most], np.int64)


def _angles(points: _Points, triangles: _Triangles) -> tuple[_Numbers, _Points]:
    """Return the ends of each edge, and the angle between the normals beside it.

    An edge of the outline has one triangle only; it gets the smaller angle of that one's
    other sides.
    """
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tails, heads = directed_edges(triangles)
    keys = undirected_keys(tails, heads, len(points))
    order = np.argsort(keys, kind="stable")
    twin = np.flatnonzero(np.diff(keys[order]) == 0)
    one, other = order[twin], order[twin + 1]
    # From the difference: the arc cosine can't tell small angles from none.
    apart = np.linalg.norm(normals[one // 3] - normals[other // 3], axis=1)
    angles = np.full(len(keys), np.inf)
    angles[one] = angles[other] = 2.0 * np.arcsin(np.minimum(0.5 * apart, 1.0))
    alone = np.flatnonzero(angles == np.inf)
    angles[alone] = angles.reshape(-1, 3).min(axis=1)[alone // 3]
    first = np.concatenate([one, alone])
    return np.column_stack([tails[first], heads[first]]), angles[first]


def _stay_first(points: _Points, ends: _Numbers, angles: _Points) -> tuple[_Numbers, _Points]:
    """Return the edges that can be merged, turned so that the end more tied to the outline leads.

    A corner stays, and what lies on a side stays there: two vertices on different sides don't
    merge.
    """
    tied = _sides(points)
    one, other = tied[ends].T
    all_sides = one | other
    mergeable = (all_sides == one) | (all_sides == other)
    ends = np.where((other > one)[:, np.newaxis], ends[:, ::-1], ends)
    return ends[mergeable], angles[mergeable]


def _sides(points: _Points) -> _Numbers:
    """Return for each vertex which sides of the rectangle it is on: 1 west, 2 east, 4 s, 8 n."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    at = np.hstack([points[:, :2] == low, points[:, :2] == high])  # west, south, east, north
    return np.asarray(at @ [1, 4, 2, 8], np.int64)


def _merged(points: _Points, merges: _Numbers) -> _Points:
    """Return the points with each pair as one: in the middle, or where a side holds the first."""
    tied = _sides(points)
    stay, go = merges.T
    is_free = tied[stay] == tied[go]
    moved = points.copy()
    moved[stay[is_free]] = 0.5 * (points[stay[is_free]] + points[go[is_free]])
    return np.delete(moved, go, axis=0)


def _delaunay(points: _Points) -> _Triangles:
    """Return Delaunay's triangles that have an area; Qhull turns them counter-clockwise."""
    from scipy.spatial import Delaunay

    triangles = Delaunay(points[:, :2]).simplices.astype(np.int32)
    corners = points[triangles, :2]
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    return np.asarray(triangles[areas > 0.0])
