"""PLY, STL and OBJ."""

from __future__ import annotations

import numpy as np

from rtin.io._placement import PlacedMesh

__all__ = ["obj", "ply", "stl"]


def ply(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as a binary PLY with 64-bit coordinates.

    Written here because trimesh and VTK know 32-bit ones only.
    """
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"comment rtin {placed.as_json()}\n"
        f"element vertex {len(placed.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(placed.triangles)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(placed.triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = placed.triangles
    return header.encode() + placed.vertices.astype("<f8").tobytes() + faces.tobytes()


def stl(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as a binary STL, which has room for nothing but 32-bit coordinates."""
    facets = np.zeros(
        len(placed.triangles),
        dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")],
    )
    facets["corners"] = placed.vertices[placed.triangles]
    crosses = placed.area_vectors()
    lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
    facets["normal"] = crosses / np.where(lengths > 0.0, lengths, 1.0)
    return b"rtin".ljust(80) + len(facets).to_bytes(4, "little") + facets.tobytes()


def obj(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as an OBJ, each number with as many digits as it takes to read it back."""
    vertices = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in placed.vertices.tolist())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (placed.triangles + 1).tolist())
    return f"# rtin {placed.as_json()}\n{vertices}{faces}".encode("ascii")
