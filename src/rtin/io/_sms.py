"""SMS's 2DM format, which QGIS and hydraulic programs such as BASEMENT read.

As XMS Wiki's "SMS:2D Mesh Files *.2dm" describes it; no maintained library reads it.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtin.io._cells import Cells, FileMesh, cut, numbers_in, stored_tags, with_tagged
from rtin.io._placement import PlacedMesh

__all__ = ["read", "sms"]

_Rows = list[tuple[int, list[bytes]]]

# Each card's kind of cell under meshio's name, and where the nodes stand in meshio's order: 2DM
# walks around the cell, from a corner to the middle of an edge and so on.
_CARDS = {
    b"E3T": ("triangle", [0, 1, 2]),
    b"E4Q": ("quad", [0, 1, 2, 3]),
    b"E6T": ("triangle6", [0, 2, 4, 1, 3, 5]),
    b"E8Q": ("quad8", [0, 2, 4, 6, 1, 3, 5, 7]),
    b"E9Q": ("quad9", [0, 2, 4, 6, 1, 3, 5, 7, 8]),
}
_MARK = b"# rtin "
_WHOLE = re.compile(rb"[+-]?\d{1,10}(\.0*)?")


def sms(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as a 2DM file.

    Cells come first, as SMS has it: of a file that is cut short they name nodes that are not there.
    MDAL, which QGIS reads by, passes over lines that are no cards.
    """
    n_triangles = len(placed.triangles)
    tags = np.ones(n_triangles, dtype=np.int64) if placed.tags is None else placed.tags
    numbers = np.arange(1, n_triangles + 1)
    rows = np.column_stack([numbers, placed.triangles + 1, tags]).tolist()
    nodes = enumerate(placed.vertices.tolist(), start=1)
    parts = [
        "MESH2D\nNUM_MATERIALS_PER_ELEM 1\n",
        f"# rtin {with_tagged(placed)}\n",
        *(f"E3T {n} {a} {b} {c} {tag}\n" for n, a, b, c, tag in rows),
        *(f"ND {number} {x!r} {y!r} {z!r}\n" for number, (x, y, z) in nodes),
    ]
    return "".join(parts).encode("ascii")


def read(path: Path) -> FileMesh:
    """Return what is in a 2DM file; cards for lines, node strings and models are passed over."""
    content = path.read_bytes()
    lines = content.splitlines()
    if not any(line.startswith(b"MESH2D") for line in lines[:10]):
        raise ValueError("it does not start with MESH2D")
    nodes, runs = _cards(lines)
    rows = _as_numbers(nodes, 4, "ND wants a number, x, y and z")
    points = rows[:, 1:]
    numbers = rows[:, 0].astype(np.int64)
    triangles, tags = cut(map(_cells, runs), points, numbers)
    found = [line for line in lines if line.startswith(_MARK)]
    stored = json.loads(found[0].removeprefix(_MARK)) if found else None
    if stored is not None and not content.endswith(b"\n"):
        raise ValueError("its last line has no end; the file is cut short")
    return FileMesh(points, triangles, stored, stored_tags(tags, stored))


def _cards(lines: list[bytes]) -> tuple[_Rows, list[tuple[bytes, _Rows]]]:
    """Return the fields of the nodes and those of cells, cells of one card after another together.

    Each has the number of its line.
    """
    nodes: _Rows = []
    runs: list[tuple[bytes, _Rows]] = []
    for number, line in enumerate(lines, start=1):
        card, *fields = line.partition(b"#")[0].split() or [b""]
        if card == b"ND":
            nodes.append((number, fields))
        elif card in _CARDS:
            if not runs or runs[-1][0] != card:
                runs.append((card, []))
            runs[-1][1].append((number, fields))
    return nodes, runs


def _cells(run: tuple[bytes, _Rows]) -> Cells:
    card, rows = run
    kind, order = _CARDS[card]
    wanted = f"{card.decode()} wants a number and {len(order)} nodes"
    numbers = _as_numbers(rows, 1 + len(order), wanted)
    whole = (numbers == np.floor(numbers)).all(axis=1)
    if not whole.all():
        raise ValueError(f"line {rows[int(np.argmin(whole))][0]}: {wanted}, got a fraction")
    return Cells(kind, numbers[:, 1:].astype(np.int64)[:, order], _materials(rows, 1 + len(order)))


def _materials(rows: _Rows, place: int) -> NDArray[np.int32] | None:
    """Return the cells' materials, 0 for those that have none; None if no cell has one."""
    if all(len(fields) <= place for _, fields in rows):
        return None
    return np.array(
        [_material(fields[place], number) if len(fields) > place else 0 for number, fields in rows],
        dtype=np.int32,
    )


def _material(field: bytes, line: int) -> int:
    material = int(field.partition(b".")[0]) if _WHOLE.fullmatch(field) else 2**31
    if not -(2**31) <= material < 2**31:
        raise ValueError(
            f"line {line}: a material is a whole number of 32 bits, "
            f"got {field[:20].decode(errors='replace')!r}"
        )
    return material


def _as_numbers(rows: _Rows, count: int, wanted: str) -> NDArray[np.float64]:
    """Return the first ``count`` fields of each row as numbers, shape (rows, count)."""
    for number, fields in rows:
        if len(fields) < count:
            raise ValueError(f"line {number}: {wanted}, got {len(fields)} fields")
    text = b" ".join(b" ".join(fields[:count]) for _, fields in rows)
    return numbers_in(text).reshape(len(rows), count)
