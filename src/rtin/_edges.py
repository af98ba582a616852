"""Edges of triangles, each as one whole number, so that sorting brings equal ones together."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["directed_edges", "edge_ends", "edge_keys", "undirected_keys"]

_Numbers = NDArray[np.int64]
_Whole = NDArray[np.integer[Any]]


def directed_edges(triangles: _Whole) -> tuple[_Numbers, _Numbers]:
    """Return start and end of every triangle's three directed edges; edge h starts at corner h."""
    corners = triangles.astype(np.int64)
    return corners.ravel(), np.roll(corners, -1, axis=1).ravel()


def edge_keys(start: _Numbers, end: _Numbers, n_vertices: int) -> _Numbers:
    """Return one number for each directed edge, equal for equal edges only."""
    return start * n_vertices + end


def undirected_keys(start: _Numbers, end: _Numbers, n_vertices: int) -> _Numbers:
    """Return the number of each edge directed from its smaller vertex number to its larger one."""
    return edge_keys(np.minimum(start, end), np.maximum(start, end), n_vertices)


def edge_ends(keys: _Numbers, n_vertices: int) -> _Numbers:
    """Return the start and end, shape (n, 2), of edges with these numbers."""
    return np.column_stack(np.divmod(keys, max(1, n_vertices)))
