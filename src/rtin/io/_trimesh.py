"""What trimesh reads: GLB, OBJ, PLY and STL."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin.io._gltf import z_up

__all__ = ["read"]

_MARK = {".ply": b"comment rtin ", ".obj": b"# rtin "}
_HEADER_BYTES = 1 << 16


def read(path: Path) -> tuple[NDArray[np.float64], NDArray[np.integer[Any]], Any]:
    """Return vertices, triangles and the stored placement (or None) of a file.

    Several meshes in one file become one; z is up for GLB too.
    """
    import trimesh

    suffix = path.suffix.lower()
    with path.open("rb") as file:
        scene: Any = trimesh.load(file, file_type=suffix[1:], force="scene", process=False)
    points, corners, n_points, stored = [], [], 0, None
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        part = scene.geometry[name]
        if not isinstance(part, trimesh.Trimesh):
            continue
        points.append(np.asarray(part.vertices) @ matrix[:3, :3].T + matrix[:3, 3])
        corners.append(np.asarray(part.faces) + n_points)
        n_points += len(part.vertices)
        stored = part.metadata.get("rtin")
    vertices = np.concatenate([np.empty((0, 3)), *points])
    triangles = np.concatenate([np.empty((0, 3), dtype=np.int64), *corners])
    if suffix == ".glb":
        return z_up(vertices), triangles, stored
    return vertices, triangles, _stored_in_header(path, suffix)


def _stored_in_header(path: Path, suffix: str) -> Any:  # noqa: ANN401
    """Return the placement in a comment near the start; trimesh drops comments."""
    mark = _MARK.get(suffix)
    with path.open("rb") as file:
        lines = file.read(_HEADER_BYTES).split(b"\n")
    found = [line for line in lines if mark is not None and line.startswith(mark)]
    return json.loads(found[0].removeprefix(mark or b"")) if found else None
