"""What mesh files hold: cells of several kinds, to be cut into triangles, and their tags."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtin.io._placement import PlacedMesh

__all__ = [
    "Cells",
    "FileMesh",
    "as_tags",
    "cut",
    "find_tags",
    "renumbered",
    "stored_tags",
    "with_tagged",
]

_Ints = NDArray[np.integer[Any]]
_Floats = NDArray[np.float64]

# Where programs keep the number of a triangle's material or zone; the first that is there counts.
TAG_NAMES = (
    "tag",
    "cell_tags",
    "gmsh:physical",
    "medit:ref",
    "material",
    "MaterialIDs",
    "material_id",
    "gmsh:geometrical",
)

# What the cells of each kind are cut into, at their own nodes: every node keeps its height. Corners
# come first in them, then the middles of the edges after each corner, then the middle.
#
#      2             3 ─ 6 ─ 2        3 ─ 6 ─ 2
#      │╲            │ ╱   ╲ │        │   │   │
#      5─4           7       5        7 ─ 8 ─ 5
#      │╲│╲          │ ╲   ╱ │        │   │   │
#      0─3─1         0 ─ 4 ─ 1        0 ─ 4 ─ 1
_TRIANGLES_OF = {
    "triangle": [[0, 1, 2]],
    "triangle6": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    "quad8": [[0, 4, 7], [4, 1, 5], [5, 2, 6], [6, 3, 7]],
}
_QUADS_OF = {
    "quad": [[0, 1, 2, 3]],
    "quad8": [[4, 5, 6, 7]],
    "quad9": [[0, 4, 8, 7], [4, 1, 5, 8], [8, 5, 2, 6], [7, 8, 6, 3]],
}


class FileMesh(NamedTuple):
    """What a reader finds in a file."""

    points: _Floats  # (n, 3), as in the file
    triangles: _Ints
    stored: Any = None  # what ``PlacedMesh.as_dict`` was when we wrote it
    tags: _Ints | None = None


class Cells(NamedTuple):
    """Cells of one kind, under meshio's name for it."""

    kind: str
    nodes: _Ints  # (k, nodes of a cell), in meshio's order
    tags: _Ints | None = None


def cut(blocks: Iterable[Cells], points: _Floats) -> tuple[_Ints, _Ints | None]:
    """Return the triangles of all blocks, in their order, and the tags of the cells they are of.

    Points and lines are passed over. Cells without a tag, where others have one, have 0.

    Raises
    ------
    ValueError
        If there are cells of another kind, such as tetrahedra, or a cell names no node.
    """
    triangles: list[_Ints] = [np.empty((0, 3), dtype=np.int64)]
    tags: list[_Ints] = []
    is_tagged = False
    for block in blocks:
        if block.kind.startswith(("vertex", "line")):
            continue
        pieces = _pieces(block, points)
        triangles.append(pieces.reshape(-1, 3))
        numbers = np.zeros(len(pieces), np.int64) if block.tags is None else block.tags
        tags.append(np.repeat(numbers, pieces.shape[1]))
        is_tagged = is_tagged or block.tags is not None
    return np.concatenate(triangles), np.concatenate(tags) if is_tagged else None


def _pieces(block: Cells, points: _Floats) -> _Ints:
    """Return the triangles of each cell, shape (cells, triangles of a cell, 3)."""
    kind, nodes = block.kind, np.asarray(block.nodes)
    if kind not in _TRIANGLES_OF and kind not in _QUADS_OF:
        raise ValueError(f"triangles and quads are wanted, got cells of kind {kind}")
    if nodes.size and not 0 <= nodes.min() <= nodes.max() < len(points):
        raise ValueError(f"a cell names a node that is not there, among {len(points)} nodes")
    triangles = nodes[:, np.array(_TRIANGLES_OF.get(kind, []), dtype=int).reshape(-1, 3)]
    quads = nodes[:, np.array(_QUADS_OF.get(kind, []), dtype=int).reshape(-1, 4)]
    return np.concatenate([triangles, _halves(quads, points)], axis=1)


def _halves(quads: _Ints, points: _Floats) -> _Ints:
    """Return two triangles for each quad, cut from its node 0 where that stays inside of it."""
    halves = [quads[..., corners].reshape(*quads.shape[:-1], 2, 3) for corners in _DIAGONALS]
    x, y, _ = np.moveaxis(points[halves[0]], -1, 0)
    areas = (x[..., 1] - x[..., 0]) * (y[..., 2] - y[..., 0])
    areas -= (x[..., 2] - x[..., 0]) * (y[..., 1] - y[..., 0])
    is_inside = areas[..., 0] * areas[..., 1] > 0.0
    chosen = np.where(is_inside[..., np.newaxis, np.newaxis], halves[0], halves[1])
    return chosen.reshape(len(quads), -1, 3)


_DIAGONALS = ([0, 1, 2, 0, 2, 3], [1, 2, 3, 1, 3, 0])


def find_tags(arrays: Mapping[str, Any]) -> _Ints | None:
    """Return the array with a usual name that has one whole number per cell; None without one."""
    for name in TAG_NAMES:
        if name in arrays:
            tags = as_tags(np.asarray(arrays[name]))
            if tags is not None:
                return tags
    return None


def as_tags(values: NDArray[Any]) -> _Ints | None:
    """Return ``values`` as whole numbers of 32 bits, None where they are something else."""
    flat = values.reshape(-1) if values.ndim == 2 and values.shape[1] == 1 else values
    if flat.ndim != 1 or flat.dtype.kind not in "iuf":
        return None
    tags = flat.astype(np.int32)
    return tags if np.array_equal(tags, flat) else None


def renumbered(blocks: Iterable[Cells], numbers: _Ints) -> list[Cells]:
    """Return cells whose nodes count from 0, of ones that name nodes by their ``numbers``.

    Raises
    ------
    ValueError
        If a cell names a number that is not there, or one is there twice.
    """
    if not len(numbers):
        raise ValueError("there are no nodes")
    order = np.argsort(numbers, kind="stable")
    ordered = numbers[order]
    is_again = ordered[1:] == ordered[:-1]
    if is_again.any():
        raise ValueError(f"node {ordered[1:][is_again][0]} is there twice")
    return [block._replace(nodes=_found(block.nodes, order, ordered)) for block in blocks]


def _found(wanted: _Ints, order: _Ints, ordered: _Ints) -> _Ints:
    place = np.minimum(np.searchsorted(ordered, wanted), len(ordered) - 1)
    is_missing = ordered[place] != wanted
    if is_missing.any():
        raise ValueError(f"a cell names node {wanted[is_missing][0]}, which is not there")
    return order[place]


def with_tagged(placed: PlacedMesh) -> str:
    """Return the placement as a line of JSON, for a format that has a tag for each triangle.

    A mesh without tags has 1 everywhere there, and the line says that it has none.
    """
    return json.dumps({**placed.as_dict(), "tagged": placed.tags is not None})


def stored_tags(tags: _Ints | None, stored: Any) -> _Ints | None:  # noqa: ANN401
    """Return ``tags`` unless the line that ``with_tagged`` wrote says that there are none."""
    return tags if stored is None or stored.get("tagged", True) else None
