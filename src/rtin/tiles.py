"""Tiles: a mesh too large for memory, made part by part and without cracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from affine import Affine
from numpy.typing import NDArray

__all__ = ["HeightLattice", "Tile"]

Span = tuple[int, int]


class HeightLattice(Protocol):
    """Heights at the nodes of a lattice of any size, read window by window.

    Attributes
    ----------
    rows, cols : (int, int)
        First node and the one after the last where heights may be. All else is void.
    period : int or None
        Columns of a lattice that goes round the world: column c and c + period are one node.
    transform : affine.Affine
        Maps (col, row) of a node to (x, y).
    crs : pyproj.CRS or None
    """

    rows: Span
    cols: Span
    period: int | None
    transform: Affine
    crs: Any

    def read(self, rows: Span, cols: Span) -> NDArray[np.floating[Any]]:
        """Return the heights of a window, in C order; NaN where void or outside.

        A node's height is the same in every window. All windows have one dtype, float32 or float64.
        """
        ...


@dataclass(frozen=True)
class Tile:
    """One tile's part of the mesh over a lattice.

    Attributes
    ----------
    row, col : int
        Of the tile, from the north-west corner of the lattice.
    cells : int
        Along a side, a power of two.
    rows, cols : ndarray of int32, shape (n,)
        Node of each vertex, 0 to ``cells`` from the tile's north-west corner, in row-major order.
    heights : ndarray of float64, shape (n,)
    slopes : ndarray of float64, shape (n, 2)
        Rise to the east and to the north from one node to the next, by central differences of the
        lattice's heights (one-sided next to voids): a property of the node, so that neighbouring
        tiles agree on it.
    triangles : ndarray of int32, shape (m, 3)
        Counter-clockwise from above; 0 and 1 end the longest edge.
    """

    row: int
    col: int
    cells: int
    rows: NDArray[np.int32]
    cols: NDArray[np.int32]
    heights: NDArray[np.float64]
    slopes: NDArray[np.float64]
    triangles: NDArray[np.int32]
