"""Closed solids: a terrain with walls and a flat bottom, as 3-D printers want."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin._edges import directed_edges, edge_keys
from rtin._number import as_positive
from rtin.mesh import TriangleMesh, require_mesh

__all__ = ["close"]

_Ints = NDArray[np.integer[Any]]

# How far the copies of a pinch vertex are pulled apart: a part of the way to the opposite edges.
_PULL = 0.01


def close(mesh: TriangleMesh, base: float) -> TriangleMesh:
    """Return the closed surface of a solid between ``mesh`` and a flat bottom.

    Parameters
    ----------
    mesh : TriangleMesh
        A terrain: triangles counter-clockwise from above, at most two at each edge. It may have
        holes and several parts.
    base : float
        How far the bottom lies below the lowest triangle corner, in the unit of z; more than zero.

    Returns
    -------
    TriangleMesh
        First the terrain's triangles, then the bottom's (the same ones, seen from below), then two
        for each boundary edge, around holes too. All face outwards, so those of the bottom are
        clockwise from above. Every edge has exactly two triangles, in opposite directions. The
        first ``mesh.n_vertices`` vertices are those of ``mesh``.

        A vertex where parts of the terrain touch at a point only (a pinch) would leave a vertical
        edge with four walls. There each part gets its own copy of the vertex, pulled sideways into
        that part by 1 % of the distance to the nearest opposite edge; no other vertex moves.

        Where ``mesh`` has tags, the terrain's triangles keep theirs and all others have 0.

    Raises
    ------
    ValueError
        If base is not more than zero, there are no triangles, a triangle is not
        counter-clockwise from above, or more than two triangles meet at an edge.
    TypeError
        If ``mesh`` is not a TriangleMesh or ``base`` not a number.
    """
    base = as_positive("base", base, ", in the unit of z")
    _check(require_mesh(mesh))
    top, corners = _split_pinches(mesh)
    bottom = top.copy()
    bottom[:, 2] = top[corners, 2].min() - base
    walls = _walls(corners, len(top))
    triangles = np.concatenate([corners, corners[:, ::-1] + len(top), walls])
    others = np.zeros(len(triangles) - mesh.n_triangles, dtype=np.int32)
    tags = None if mesh.tags is None else np.concatenate([mesh.tags, others])
    return TriangleMesh(np.concatenate([top, bottom]), triangles, mesh.crs, tags)


def _check(mesh: TriangleMesh) -> None:
    if mesh.n_triangles == 0:
        raise ValueError("a mesh with triangles is wanted for a solid, got one without any")
    if not (mesh.signed_areas() > 0.0).all():
        raise ValueError(
            "a solid needs triangles that are counter-clockwise from above, got others too; "
            "TriangleMesh.from_triangles turns them"
        )
    keys = np.sort(edge_keys(*directed_edges(mesh.triangles), mesh.n_vertices))
    if (keys[1:] == keys[:-1]).any():
        raise ValueError("a solid needs at most two triangles at each edge, got more at some")


def _boundary(corners: _Ints, n_vertices: int) -> NDArray[np.intp]:
    """Return the numbers of the half edges that have a triangle on their left only."""
    start, end = directed_edges(corners)
    keys = np.sort(edge_keys(start, end, n_vertices))
    return np.flatnonzero(_find(keys, edge_keys(end, start, n_vertices)) < 0)


def _find(ordered: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return where each wanted value is in the ascending ``ordered``; -1 where it is not."""
    place = np.minimum(np.searchsorted(ordered, wanted), len(ordered) - 1)
    return np.where(ordered[place] == wanted, place, -1)


def _walls(corners: _Ints, n_top: int) -> _Ints:
    """Return two triangles below each boundary edge, facing away from the terrain.

    ::

        start ── end        the terrain lies behind the page:
          │   ╱   │         it is on the left of its boundary edges
        below ─ below
    """
    half_edges = _boundary(corners, n_top)
    start, end = (ends[half_edges] for ends in directed_edges(corners))
    upper = np.column_stack([end, start, start + n_top])
    lower = np.column_stack([end, start + n_top, end + n_top])
    return np.stack([upper, lower], axis=1).reshape(-1, 3)


def _split_pinches(mesh: TriangleMesh) -> tuple[NDArray[np.float64], _Ints]:
    """Return vertices and triangles in which each vertex has one fan of triangles around it."""
    firsts = _first_edges_of_pinch_fans(mesh)
    if firsts.size == 0:
        return mesh.vertices, mesh.triangles
    fans, half_edges, lasts = _walk_fans(mesh, firsts)
    pivots, nexts = (ends[firsts] for ends in directed_edges(mesh.triangles))
    copies = _numbers_of_copies(pivots, mesh.n_vertices)
    corners = mesh.triangles.copy()
    corners.ravel()[half_edges] = copies[fans]
    reach = np.full(len(firsts), np.inf)
    np.minimum.at(reach, fans, _altitudes(mesh, half_edges))
    pull = _PULL * reach[:, np.newaxis] * _bisectors(mesh.vertices[:, :2], pivots, nexts, lasts)
    vertices = np.concatenate([mesh.vertices, np.empty((copies.max() + 1 - mesh.n_vertices, 3))])
    vertices[copies] = mesh.vertices[pivots]
    vertices[copies, :2] += pull
    return vertices, corners


def _first_edges_of_pinch_fans(mesh: TriangleMesh) -> NDArray[np.intp]:
    """Return the boundary half edges that start where more than one of them starts."""
    boundary = _boundary(mesh.triangles, mesh.n_vertices)
    pivots = mesh.triangles.ravel()[boundary]
    return boundary[np.bincount(pivots)[pivots] > 1]


def _walk_fans(
    mesh: TriangleMesh, firsts: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp], _Ints]:
    """Walk every fan counter-clockwise from its first half edge, all fans a step at a time.

    Returns the fan and the half edge of each step, and the last vertex around each fan.
    """
    start, end = directed_edges(mesh.triangles)
    keys = edge_keys(start, end, mesh.n_vertices)
    order = np.argsort(keys)
    keys = keys[order]
    lasts = np.empty(len(firsts), dtype=start.dtype)
    fans, half_edges = np.arange(len(firsts)), firsts
    steps = []
    while fans.size:
        steps.append((fans, half_edges))
        third = start[half_edges - half_edges % 3 + (half_edges + 2) % 3]
        lasts[fans] = third
        found = _find(keys, edge_keys(start[half_edges], third, mesh.n_vertices))
        fans, half_edges = fans[found >= 0], order[found[found >= 0]]
    all_fans, all_half_edges = (np.concatenate(part) for part in zip(*steps, strict=True))
    return all_fans, all_half_edges, lasts


def _numbers_of_copies(pivots: _Ints, n_vertices: int) -> _Ints:
    """Return a vertex number per fan: the old one for the first of each pivot, then new ones."""
    _, kept = np.unique(pivots, return_index=True)
    is_new = np.ones(len(pivots), dtype=bool)
    is_new[kept] = False
    copies = pivots.copy()
    copies[is_new] = n_vertices + np.arange(np.count_nonzero(is_new))
    return copies


def _altitudes(mesh: TriangleMesh, half_edges: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return how far, in x and y, each half edge's start is from its triangle's opposite edge."""
    first = half_edges - half_edges % 3
    corners = mesh.triangles.ravel()
    ends = [mesh.vertices[corners[first + (half_edges + i) % 3], :2] for i in (1, 2)]
    areas = mesh.signed_areas()[half_edges // 3]
    return np.asarray(2.0 * areas / np.linalg.norm(ends[1] - ends[0], axis=1))


def _bisectors(
    points: NDArray[np.float64], pivots: _Ints, firsts: _Ints, lasts: _Ints
) -> NDArray[np.float64]:
    """Return unit vectors from each pivot through the middle of its fan, however wide the fan is.

    The sum of all directions in a fan, counter-clockwise from ``first`` to ``last``, is the
    difference of the last and the first one turned clockwise by a right angle.
    """
    along = [points[ends] - points[pivots] for ends in (firsts, lasts)]
    first, last = (edges / np.linalg.norm(edges, axis=1, keepdims=True) for edges in along)
    across = (last - first)[:, ::-1] * [1.0, -1.0]
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))
