"""What trimesh reads: GLB, OBJ, PLY and STL."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin.io._cells import FileMesh
from rtin.io._gltf import z_up
from rtin.io._numbers import require_plausible

__all__ = ["read"]

_MARK = {".ply": b"comment rtin ", ".obj": b"# rtin "}
_HEADER_BYTES = 1 << 16


def read(path: Path) -> FileMesh:
    """Return vertices, triangles and the stored placement (or None) of a file.

    Several meshes in one file become one; z is up for GLB too.
    """
    import trimesh

    suffix = path.suffix.lower()
    # Without this its OBJ reader drops vertices that no triangle uses.
    options: Any = {"maintain_order": True} if suffix == ".obj" else {}
    # From memory: asked for the gigabytes that a damaged file announces, a file on disk would
    # reserve them before it finds out how short it is.
    data = path.read_bytes()
    if suffix == ".glb":
        require_plausible(_announced(data), len(data))
    file = BytesIO(data)
    scene: Any = trimesh.load(file, file_type=suffix[1:], force="scene", process=False, **options)
    vertices, triangles, stored = _joined(scene)
    if suffix == ".glb":
        return FileMesh(z_up(vertices), triangles, stored)
    stored = _stored_in_header(path, suffix)
    if stored is not None and stored["triangles"] != len(triangles):
        raise ValueError(
            f"{stored['triangles']} triangles are announced but {len(triangles)} are there; "
            "the file is cut short, or was changed without its first comment"
        )
    return FileMesh(vertices, triangles, stored)


def _announced(glb: bytes) -> int:
    """Return how many values the accessors of a GLB are said to have together."""
    n_bytes = int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20 : 20 + n_bytes])
    return sum(accessor["count"] for accessor in tree.get("accessors", []))


def _joined(scene: Any) -> tuple[NDArray[np.float64], NDArray[np.integer[Any]], Any]:  # noqa: ANN401
    """Return the vertices and triangles of all meshes of a trimesh scene, where its nodes put them.

    A single mesh also has what it stores under "rtin".
    """
    points, corners, n_points, stored = [], [], 0, []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        part = scene.geometry[name]
        if not hasattr(part, "faces"):
            continue
        points.append(np.asarray(part.vertices) @ matrix[:3, :3].T + matrix[:3, 3])
        corners.append(np.asarray(part.faces) + n_points)
        n_points += len(part.vertices)
        stored.append(part.metadata.get("rtin"))
    vertices = np.concatenate([np.empty((0, 3)), *points])
    triangles = np.concatenate([np.empty((0, 3), dtype=np.int64), *corners])
    return vertices, triangles, stored[0] if len(stored) == 1 else None


def _stored_in_header(path: Path, suffix: str) -> Any:  # noqa: ANN401
    """Return the placement in a comment near the start; trimesh drops comments."""
    mark = _MARK.get(suffix)
    with path.open("rb") as file:
        lines = file.read(_HEADER_BYTES).split(b"\n")
    found = [line for line in lines if mark is not None and line.startswith(mark)]
    return json.loads(found[0].removeprefix(mark or b"")) if found else None
