"""Selection of triangles: by a condition written as text, or by a file of their numbers.

For the command line and other places where targets come from people; programs have NumPy.
"""

from __future__ import annotations

import ast
import operator
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin.mesh import TriangleMesh, require_mesh

__all__ = ["read_numbers", "where"]

_LONGEST_TEXT = 1000

_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.And: np.logical_and,
    ast.Or: np.logical_or,
    ast.Not: np.logical_not,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "hypot": np.hypot,
    "min": np.minimum,
    "max": np.maximum,
}
_QUANTITIES: dict[str, Callable[[TriangleMesh], NDArray[Any]]] = {
    "x": lambda mesh: _corners(mesh)[:, :, 0].mean(axis=1),
    "y": lambda mesh: _corners(mesh)[:, :, 1].mean(axis=1),
    "z": lambda mesh: _corners(mesh)[:, :, 2].mean(axis=1),
    "z_min": lambda mesh: _corners(mesh)[:, :, 2].min(axis=1),
    "z_max": lambda mesh: _corners(mesh)[:, :, 2].max(axis=1),
    "area": TriangleMesh.signed_areas,
    "length": lambda mesh: _longest_edges(mesh),
    "slope": lambda mesh: _slopes(mesh),
    "tag": lambda mesh: _tags(mesh),
    "number": lambda mesh: np.arange(mesh.n_triangles),
}


def where(mesh: TriangleMesh, condition: str) -> NDArray[np.bool_]:
    """Return which triangles meet a condition, such as ``"z > 100 and slope < 30"``.

    Parameters
    ----------
    mesh : TriangleMesh
    condition : str
        Of these quantities, for each triangle in the units of the mesh: ``x``, ``y``, ``z`` of its
        middle; ``z_min``, ``z_max`` of its corners; ``area`` and longest edge's ``length`` in the
        xy plane; ``slope`` in degrees; ``tag``; ``number``. They are put together by numbers,
        ``+ - * / % **``, ``< <= > >= == !=`` (as in ``10 < z < 20``, too), ``and or not``,
        brackets, and ``abs sqrt hypot min max``. Nothing else is run, whatever the text says.

    Returns
    -------
    ndarray of bool, shape (m,)

    Raises
    ------
    ValueError
        If the condition is not of this kind.
    """
    require_mesh(mesh)
    if len(condition) > _LONGEST_TEXT:
        raise ValueError(
            f"a condition has at most {_LONGEST_TEXT} characters, got {len(condition)}"
        )
    unreadable = ValueError(f"a condition such as 'z > 100' is wanted, got {condition[:60]!r}")
    try:
        tree = ast.parse(condition.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise unreadable from None
    try:
        with np.errstate(all="ignore"):
            found = np.asarray(_value(tree, mesh, condition))
    except RecursionError:
        raise unreadable from None
    if found.dtype != np.bool_:
        raise ValueError(f"a condition that is true or false is wanted, got {condition!r}")
    return np.array(np.broadcast_to(found, mesh.n_triangles))


def _value(node: ast.AST, mesh: TriangleMesh, condition: str) -> Any:  # noqa: ANN401
    """Return the value of one part of a condition."""
    number = node.value if isinstance(node, ast.Constant) else None
    if isinstance(number, int | float) and not isinstance(number, bool):
        return np.float64(number)
    if isinstance(node, ast.Name) and node.id in _QUANTITIES:
        return _QUANTITIES[node.id](mesh)
    found = _operation(node)
    if found is None:
        text = ast.get_source_segment(condition.strip(), node) or condition
        raise ValueError(
            f"cannot use {text!r} in a condition; there are the quantities "
            f"{', '.join(_QUANTITIES)}, the functions {', '.join(_FUNCTIONS)}, and, or, not"
        )
    operate, parts = found
    values = [_value(part, mesh, condition) for part in parts]
    if isinstance(node, ast.BoolOp) or isinstance(getattr(node, "op", None), ast.Not):
        for part, value in zip(parts, values, strict=True):
            _require_truth(value, ast.get_source_segment(condition.strip(), part) or condition)
    return operate(*values)


def _require_truth(value: Any, text: str) -> None:  # noqa: ANN401
    if np.asarray(value).dtype != np.bool_:
        raise ValueError(f"and, or, not want something true or false in a condition, got {text!r}")


def _operation(node: ast.AST) -> tuple[Callable[..., Any], list[ast.expr]] | None:
    """Return what a part of a condition does to which parts of its own, if that is known."""
    match node:
        case ast.UnaryOp(op=op, operand=part) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)], [part]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)], [left, right]
        case ast.BoolOp(op=op, values=parts):
            return _in_a_row([_OPERATORS[type(op)]] * (len(parts) - 1)), parts
        case ast.Compare(left=left, ops=ops, comparators=parts):
            if all(type(op) in _OPERATORS for op in ops):
                return _compared([_OPERATORS[type(op)] for op in ops]), [left, *parts]
        case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]) if name in _FUNCTIONS:
            return _called(name, len(parts)), parts
    return None


def _in_a_row(operators: list[Callable[..., Any]]) -> Callable[..., Any]:
    """Return ``a op b op c …``, worked out from the left."""

    def operate(value: Any, *others: Any) -> Any:  # noqa: ANN401
        for operation, other in zip(operators, others, strict=True):
            value = operation(value, other)
        return value

    return operate


def _compared(operators: list[Callable[..., Any]]) -> Callable[..., Any]:
    """Return ``a < b < c …``: whether all neighbours compare so."""

    def operate(*values: Any) -> Any:  # noqa: ANN401
        pairs = zip(operators, values, values[1:], strict=False)
        return np.logical_and.reduce([compare(a, b) for compare, a, b in pairs])

    return operate


def _called(name: str, n_values: int) -> Callable[..., Any]:
    wanted = 1 if name in ("abs", "sqrt") else 2
    if n_values != wanted:
        raise ValueError(f"{name} takes {wanted} values in a condition, got {n_values}")
    return _FUNCTIONS[name]


def _corners(mesh: TriangleMesh) -> NDArray[np.float64]:
    return mesh.vertices[mesh.triangles]


def _longest_edges(mesh: TriangleMesh) -> NDArray[np.float64]:
    corners = _corners(mesh)[:, :, :2]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    return np.asarray(lengths.max(axis=1))


def _slopes(mesh: TriangleMesh) -> NDArray[np.float64]:
    corners = _corners(mesh)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across = np.hypot(normals[:, 0], normals[:, 1])
    return np.asarray(np.degrees(np.arctan2(across, np.abs(normals[:, 2]))))


def _tags(mesh: TriangleMesh) -> NDArray[np.int32]:
    if mesh.tags is None:
        raise ValueError("the mesh has no tags to select triangles by")
    return mesh.tags


def read_numbers(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Return the numbers of triangles, or a boolean for each, that a file lists.

    Parameters
    ----------
    path : str or path-like
        .npy with whole numbers or booleans; any other extension: text, numbers apart by spaces,
        commas or new lines, what follows a # left out.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it holds something else; whether the triangles exist is for ``refine`` to see.
    """
    file = Path(path)
    if file.suffix.lower() == ".npy":
        with file.open("rb") as stream:
            try:
                return np.asarray(np.load(stream, allow_pickle=False)).ravel()
            except (ValueError, EOFError, OSError) as error:
                raise ValueError(f"cannot read {path} as .npy: {error}") from None
    numbers: list[int] = []
    try:
        lines = file.read_text("utf-8").splitlines()
    except UnicodeDecodeError:
        raise ValueError(f"{path} is neither text nor .npy") from None
    for count, line in enumerate(lines, start=1):
        for word in line.partition("#")[0].replace(",", " ").split():
            if not word.isdigit() or len(word) > 18:
                raise ValueError(
                    f"numbers of triangles are wanted in {path}, got {word[:40]!r} on line {count}"
                )
            numbers.append(int(word))
    return np.array(numbers, np.int64)
