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
    import trimesh
    from trimesh.exchange.stl import export_stl

    data = export_stl(trimesh.Trimesh(placed.vertices, placed.triangles, process=False))
    assert isinstance(data, bytes)
    return data


def obj(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as an OBJ, its coordinates with six decimals or nine digits."""
    import trimesh
    from trimesh.exchange.obj import export_obj

    extent = float(np.ptp(placed.terrain_bounds[:, :2], axis=0).max()) or 1.0
    text = export_obj(  # type: ignore[no-untyped-call]
        trimesh.Trimesh(placed.vertices, placed.triangles, process=False),
        include_normals=False,
        include_color=False,
        include_texture=False,
        digits=max(6, 9 - int(np.floor(np.log10(extent)))),
        header=f"rtin {placed.as_json()}",
    )
    assert isinstance(text, str)
    return text.encode()
