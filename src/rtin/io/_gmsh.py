"""Gmsh's MSH format: version 2.2 out, 2 and 4.1 in, as text and binary.

Written out is 2.2, in which each triangle has its own tags, so that the triangles keep their order;
4.1 sorts them by tag. It is also what most other programs read. Read is by the format's description
(Gmsh's reference manual, "MSH file format"): meshio makes room for as many nodes as their largest
number says, and refuses surfaces of which only some have a physical group.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin.io._cells import Cells, FileMesh, cut, numbers_in, stored_tags, with_tagged
from rtin.io._placement import PlacedMesh

__all__ = ["msh", "read"]

_Ints = NDArray[np.integer[Any]]
_Physicals = dict[tuple[int, int], int]

# Gmsh's number of each kind of cell: meshio's name for the kind, and how many nodes a cell has.
_KINDS = {
    1: ("line", 2),
    2: ("triangle", 3),
    3: ("quad", 4),
    4: ("tetra", 4),
    5: ("hexahedron", 8),
    6: ("wedge", 6),
    7: ("pyramid", 5),
    8: ("line3", 3),
    9: ("triangle6", 6),
    10: ("quad9", 9),
    11: ("tetra10", 10),
    15: ("vertex", 1),
    16: ("quad8", 8),
    26: ("line4", 4),
}
_FORMAT = re.compile(
    rb"\$MeshFormat\s+(\d+(?:\.\d+)?)[ \t]+([01])[ \t]+([48])[ \t]*\r?\n(.{4})", re.S
)
_MARK = re.compile(rb"\$Comments\s+rtin (\{.*\})\s+\$EndComments")


def msh(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as an MSH 2.2 text file.

    The comment stands at the end, where readers that want nodes first do not meet it.
    """
    n_vertices, n_triangles = len(placed.vertices), len(placed.triangles)
    tags = np.ones(n_triangles, dtype=np.int64) if placed.tags is None else placed.tags
    numbers = np.arange(1, n_triangles + 1)
    rows = np.column_stack([numbers, tags, _entities(tags), placed.triangles + 1]).tolist()
    nodes = enumerate(placed.vertices.tolist(), start=1)
    parts = [
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{n_vertices}\n",
        *(f"{number} {x!r} {y!r} {z!r}\n" for number, (x, y, z) in nodes),
        f"$EndNodes\n$Elements\n{n_triangles}\n",
        *(f"{n} 2 2 {tag} {entity} {a} {b} {c}\n" for n, tag, entity, a, b, c in rows),
        f"$EndElements\n$Comments\nrtin {with_tagged(placed)}\n$EndComments\n",
    ]
    return "".join(parts).encode("ascii")


def _entities(tags: _Ints) -> _Ints:
    """Return a number of a surface for each triangle, another one for each tag.

    Physical groups are groups of surfaces: on one surface, all triangles would be in all groups.
    Gmsh drops triangles whose surface has a negative number.
    """
    return tags if tags.min() > 0 else np.unique(tags, return_inverse=True)[1].reshape(-1) + 1


def read(path: Path) -> FileMesh:
    """Return what is in an MSH file of version 2 or 4.1."""
    content = path.read_bytes()
    found = _FORMAT.search(content)
    if found is None:
        raise ValueError("there is no $MeshFormat at its start")
    version, is_binary, word, one = found.groups()
    order = "" if is_binary == b"0" else "<" if one == b"\1\0\0\0" else ">"
    if version == b"4.1":
        numbers, points, blocks = _version_4(content, order, int(word))
    elif version.startswith(b"2"):
        numbers, points, blocks = _version_2(content, order)
    else:
        raise ValueError(f"MSH 2.2 and 4.1 are read, got {version.decode()}; save it anew in Gmsh")
    triangles, tags = cut(blocks, points, numbers)
    stored = _stored(content)
    return FileMesh(points, triangles, stored, stored_tags(tags, stored))


def _stored(content: bytes) -> Any:  # noqa: ANN401
    found = _MARK.search(content)
    if found is None and content.count(b"\n$Comments") > content.count(b"\n$EndComments"):
        raise ValueError("$EndComments is missing; the file is cut short")
    return None if found is None else json.loads(found[1])


def _section(content: bytes, name: str) -> bytes:
    """Return what is between the lines $name and $Endname."""
    found = re.search(rb"\$" + name.encode() + rb"[ \t]*\r?\n", content)
    if found is None:
        raise ValueError(f"it has no ${name}")
    end = content.find(b"$End" + name.encode(), found.end())
    if end < 0:
        raise ValueError(f"$End{name} is missing; the file is cut short")
    return content[found.end() : end]


class _Numbers:
    """The numbers of a section, taken one after the other.

    Parameters
    ----------
    section : bytes
    order : str
        "" for text; in binary sections "<" or ">", as the least or the most significant byte is
        the first.
    """

    def __init__(self, section: bytes, order: str) -> None:
        self._order = order  # of bytes
        self._at = 0
        self._values: Any = section if order else numbers_in(section)

    def take(self, kind: str, count: int) -> NDArray[Any]:
        """Return the next ``count`` numbers of a kind that NumPy names, such as "i4"."""
        size = int(kind[1]) if self._order else 1
        if not 0 <= count <= (len(self._values) - self._at) // size:
            raise ValueError(f"{count:,} more numbers are announced than are there")
        start, self._at = self._at, self._at + count * size
        if self._order:
            values = np.frombuffer(self._values, self._order + kind, count, start)
        else:
            values = self._values[start : self._at]
        return values.astype(np.float64 if kind.startswith("f") else np.int64)

    def take_one(self, kind: str) -> int:
        """Return the next number, a whole one."""
        return int(self.take(kind, 1)[0])

    def count_rows(self, width: int, limit: int) -> int:
        """Return how many of the next rows of a text have the numbers 1 and 2 of the first."""
        seen = 1
        while True:
            rows = self._values[self._at : self._at + min(seen, limit) * width]
            rows = rows[: len(rows) // width * width].reshape(-1, width)
            is_alike = (rows[:, 1:3] == rows[:1, 1:3]).all(axis=1)
            if not is_alike.all():
                return int(np.argmin(is_alike))
            if len(rows) < seen:
                return max(len(rows), 1)
            seen *= 2

    def put_back(self, count: int) -> None:
        """Take the last ``count`` numbers of a text once more."""
        self._at -= count


def _kind(number: int) -> tuple[str, int]:
    if number not in _KINDS:
        raise ValueError(f"triangles and quads are wanted, got cells of Gmsh's type {number}")
    return _KINDS[number]


# --- version 2 ----------------------------------------------------------------------------------


def _version_2(content: bytes, order: str) -> tuple[_Ints, NDArray[np.float64], list[Cells]]:
    count, section = _counted(_section(content, "Nodes"))
    if order:
        record = np.dtype([("number", f"{order}i4"), ("place", f"{order}f8", 3)])
        nodes = np.frombuffer(section, record, count)
        numbers, points = nodes["number"], nodes["place"]
    else:
        rows = _Numbers(section, order).take("f8", 4 * count).reshape(-1, 4)
        numbers, points = rows[:, 0], rows[:, 1:]
    count, section = _counted(_section(content, "Elements"))
    cells = (_rows if order else _rows_of_text)(_Numbers(section, order), count)
    return numbers.astype(np.int64), points.astype(np.float64), _with_best_tags(list(cells))


def _counted(section: bytes) -> tuple[int, bytes]:
    """Return the number in the first line of a section, and what comes after that line."""
    line, _, rest = section.partition(b"\n")
    count = int(line)
    if count < 0:
        raise ValueError(f"a count must be zero or more, got {count}")
    return count, rest


def _rows_of_text(cells: _Numbers, count: int) -> Iterator[tuple[str, _Ints, _Ints]]:
    """Yield the kind, the tags and the nodes of cells alike that follow each other."""
    while count > 0:
        _, number, n_tags = cells.take("i4", 3).tolist()
        cells.put_back(3)
        kind, n_nodes = _kind(number)
        width = _width(n_tags, n_nodes)
        n_alike = cells.count_rows(2 + width, count)
        rows = cells.take("i4", n_alike * (2 + width)).reshape(n_alike, -1)
        yield kind, rows[:, 3 : 3 + n_tags], rows[:, 3 + n_tags :]
        count -= n_alike


def _rows(cells: _Numbers, count: int) -> Iterator[tuple[str, _Ints, _Ints]]:
    """Do what ``_rows_of_text`` does for a binary section."""
    while count > 0:
        number, n_alike, n_tags = cells.take("i4", 3).tolist()
        kind, n_nodes = _kind(number)
        width = _width(n_tags, n_nodes)
        rows = cells.take("i4", n_alike * width).reshape(max(n_alike, 1), -1)
        yield kind, rows[:, 1 : 1 + n_tags], rows[:, 1 + n_tags :]
        count -= max(n_alike, 1)


def _width(n_tags: int, n_nodes: int) -> int:
    if n_tags < 0:
        raise ValueError(f"a cell must have zero tags or more, got {n_tags}")
    return 1 + n_tags + n_nodes


# --- version 4.1 --------------------------------------------------------------------------------


def _version_4(
    content: bytes, order: str, word: int
) -> tuple[_Ints, NDArray[np.float64], list[Cells]]:
    size = f"u{word}"
    physicals: _Physicals = {}
    if b"$Entities" in content:
        physicals = _physicals(_Numbers(_section(content, "Entities"), order), size)
    numbers, points = _nodes(_Numbers(_section(content, "Nodes"), order), size)
    blocks = _blocks(_Numbers(_section(content, "Elements"), order), size, physicals)
    return numbers, points, _with_best_tags(list(blocks))


def _physicals(entities: _Numbers, size: str) -> _Physicals:
    """Return the first physical group of each entity, by its dimension and number.

    Gmsh makes the number negative where the group has the other orientation.
    """
    found: _Physicals = {}
    for dimension, count in enumerate(entities.take(size, 4).tolist()):
        for _ in range(count):
            entity = entities.take_one("i4")
            entities.take("f8", 3 if dimension == 0 else 6)
            groups = entities.take("i4", entities.take_one(size)).tolist()
            if groups:
                found[dimension, entity] = abs(groups[0])
            if dimension > 0:
                entities.take("i4", entities.take_one(size))
    return found


def _nodes(nodes: _Numbers, size: str) -> tuple[_Ints, NDArray[np.float64]]:
    numbers, points = [np.empty(0, np.int64)], [np.empty((0, 3))]
    for _ in range(nodes.take(size, 4).tolist()[0]):
        dimension, _, is_parametric = nodes.take("i4", 3).tolist()
        count = nodes.take_one(size)
        numbers.append(nodes.take(size, count))
        width = 3 + (dimension if is_parametric else 0)
        points.append(nodes.take("f8", width * count).reshape(-1, width)[:, :3])
    return np.concatenate(numbers), np.concatenate(points)


def _blocks(
    elements: _Numbers, size: str, physicals: _Physicals
) -> Iterator[tuple[str, _Ints, _Ints]]:
    """Yield the kind, the tags (physical and geometrical) and the nodes of each block's cells."""
    for _ in range(elements.take(size, 4).tolist()[0]):
        dimension, entity, number = elements.take("i4", 3).tolist()
        kind, n_nodes = _kind(number)
        count = elements.take_one(size)
        rows = elements.take(size, count * (1 + n_nodes)).reshape(-1, 1 + n_nodes)
        tags = np.array([[physicals.get((dimension, entity), 0), entity]])
        yield kind, np.broadcast_to(tags, (count, 2)), rows[:, 1:]


def _with_best_tags(rows: list[tuple[str, _Ints, _Ints]]) -> list[Cells]:
    """Return cells with their physical groups or, in a file without any, with their entities."""
    of_area = [tags for kind, tags, _ in rows if kind.startswith(("triangle", "quad"))]
    for column in (0, 1):
        if any(tags.shape[1] > column and tags[:, column].any() for tags in of_area):
            return [
                Cells(kind, nodes, tags[:, column] if tags.shape[1] > column else None)
                for kind, tags, nodes in rows
            ]
    return [Cells(kind, nodes) for kind, _, nodes in rows]
