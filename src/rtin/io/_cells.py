"""What mesh files hold: cells of several kinds, to be cut into triangles, and their tags."""

from __future__ import annotations

import json
import warnings
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
    "numbers_in",
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


def cut(
    blocks: Iterable[Cells], points: _Floats, numbers: _Ints | None = None
) -> tuple[_Ints, _Ints | None]:
    """Return the triangles of all blocks, in their order, and the tags of the cells they are of.

    Points and lines are passed over. Cells without a tag, where others have one, have 0. Nodes are
    named by ``numbers``, one for each point; they count from 0 where that is left out.

    Raises
    ------
    ValueError
        If there are cells of another kind, such as tetrahedra, a cell names a node that is not
        there, or one is there twice.
    """
    kinds = _by_kind(blocks)
    is_tagged = any(block.tags is not None for blocks in kinds.values() for _, block in blocks)
    triangles: list[_Ints] = [np.empty((0, 3), dtype=np.int64)]
    tags: list[_Ints] = [np.empty(0, dtype=np.int64)]
    places: list[_Ints] = [np.empty(0, dtype=np.int64)]
    for kind, numbered in kinds.items():
        nodes = np.concatenate([block.nodes for _, block in numbered])
        if numbers is not None:
            nodes = _indices_of(nodes, numbers)
        pieces = _pieces(kind, nodes, points)
        n_pieces = pieces.shape[1]
        triangles.append(pieces.reshape(-1, 3))
        tags.append(np.repeat(np.concatenate([_tags(block) for _, block in numbered]), n_pieces))
        lengths = [len(block.nodes) * n_pieces for _, block in numbered]
        places.append(np.repeat([place for place, _ in numbered], lengths))
    order = np.argsort(np.concatenate(places), kind="stable")
    return np.concatenate(triangles)[order], np.concatenate(tags)[order] if is_tagged else None


def _by_kind(blocks: Iterable[Cells]) -> dict[str, list[tuple[int, Cells]]]:
    """Return the blocks of each kind, with their places: there may be as many as cells."""
    kinds: dict[str, list[tuple[int, Cells]]] = {}
    for place, block in enumerate(blocks):
        if not block.kind.startswith(("vertex", "line")):
            kinds.setdefault(block.kind, []).append((place, block))
    return kinds


def _tags(block: Cells) -> _Ints:
    return np.zeros(len(block.nodes), dtype=np.int64) if block.tags is None else block.tags


def _pieces(kind: str, nodes: _Ints, points: _Floats) -> _Ints:
    """Return the triangles of each cell, shape (cells, triangles of a cell, 3)."""
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


def _indices_of(wanted: _Ints, numbers: _Ints) -> _Ints:
    """Return where each of the ``wanted`` stands among ``numbers``."""
    if not len(numbers):
        raise ValueError("there are no nodes")
    order = np.argsort(numbers, kind="stable")
    ordered = numbers[order]
    is_again = ordered[1:] == ordered[:-1]
    if is_again.any():
        raise ValueError(f"node {ordered[1:][is_again][0]} is there twice")
    place = np.minimum(np.searchsorted(ordered, wanted), len(ordered) - 1)
    is_missing = ordered[place] != wanted
    if is_missing.any():
        raise ValueError(f"a cell names node {wanted[is_missing][0]}, which is not there")
    return order[place]


def numbers_in(text: bytes) -> _Floats:
    """Return the numbers of a text; raise ValueError where something else is among them."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # what older NumPy says
            return np.fromstring(text, dtype=np.float64, sep=" ")
    except (ValueError, DeprecationWarning):
        raise ValueError("something that is no number stands where numbers are wanted") from None


def with_tagged(placed: PlacedMesh) -> str:
    """Return the placement as a line of JSON, for a format that has a tag for each triangle.

    A mesh without tags has 1 everywhere there, and the line says that it has none.
    """
    return json.dumps({**placed.as_dict(), "tagged": placed.tags is not None})


def stored_tags(tags: _Ints | None, stored: Any) -> _Ints | None:  # noqa: ANN401
    """Return ``tags`` unless the line that ``with_tagged`` wrote says that there are none."""
    return tags if stored is None or stored.get("tagged", True) else None
