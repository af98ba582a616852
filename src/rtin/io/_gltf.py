"""Binary glTF (GLB) through trimesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin import _tint
from rtin.io._placement import PlacedMesh

__all__ = ["encode", "glb", "vertex_normals", "y_up", "z_up"]

_Floats = NDArray[np.float64]
_Tree = dict[str, Any]


def glb(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as a GLB: y up, tinted by height, around a node at its middle."""
    shift = placed.centre
    low, high = placed.terrain_bounds[:, 2]
    colours = _tint.linear(_tint.tint(placed.vertices[:, 2], low, high))

    def finish(tree: _Tree) -> None:
        tree["nodes"][0]["translation"] = y_up(shift).tolist()

    return encode(placed, shift, colours, finish)


def encode(
    placed: PlacedMesh, shift: _Floats, colours: _Floats, finish: Callable[[_Tree], None]
) -> bytes:
    """Return a GLB of one mesh, its vertices less ``shift``; ``finish`` may change its JSON.

    Solids have no normals: viewers then shade each triangle flat, so that the rim stays sharp.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb

    normals = None if placed.is_solid else y_up(vertex_normals(placed))
    terrain = trimesh.Trimesh(
        y_up(placed.vertices - shift),
        placed.triangles,
        vertex_normals=normals,
        visual=_visual(_texture_coordinates(placed), colours),
        metadata={"rtin": placed.as_dict()},
        process=False,
    )

    def finish_all(tree: _Tree) -> None:
        tree["asset"]["generator"] = "rtin"
        tree["nodes"] = [{"name": "terrain", "mesh": 0}]
        tree["scenes"] = [{"nodes": [0]}]
        finish(tree)

    scene = trimesh.Scene()
    scene.add_geometry(terrain, geom_name="terrain")
    data = export_glb(  # type: ignore[no-untyped-call]
        scene,
        include_normals=normals is not None,
        unitize_normals=False,
        tree_postprocessor=finish_all,
    )
    assert isinstance(data, bytes)
    return data


def y_up(points: _Floats) -> _Floats:
    """Return points or directions, shape (..., 3), with x east, y up and z south, as in glTF."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def z_up(points: _Floats) -> _Floats:
    """Return the inverse of ``y_up``."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def vertex_normals(placed: PlacedMesh) -> _Floats:
    """Return unit normals, shape (n, 3): the mean of the triangles around, weighted by area.

    A vertex that no triangle uses, or whose triangles cancel out, has (0, 0, 1).
    """
    corners = placed.vertices[placed.triangles]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    numbers = placed.triangles.ravel()
    n_vertices = len(placed.vertices)
    sums = np.column_stack(
        [np.bincount(numbers, np.repeat(crosses[:, i], 3), n_vertices) for i in range(3)]
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(lengths > 0.0, sums / np.where(lengths > 0.0, lengths, 1.0), [0.0, 0.0, 1.0])


def _texture_coordinates(placed: PlacedMesh) -> _Floats:
    """Return u from west to east and v from south to north, 0 to 1 over the terrain's bounds.

    trimesh turns v around: in glTF v = 0 is the top row of an image, so the north.
    """
    low, high = placed.terrain_bounds[:, :2]
    extent = np.where(high > low, high - low, 1.0)
    return np.asarray((placed.vertices[:, :2] - low) / extent)


def _visual(uv: _Floats, colours: _Floats) -> Any:  # noqa: ANN401  (trimesh has no types)
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    material = PBRMaterial(  # type: ignore[no-untyped-call]
        metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    visual = TextureVisuals(uv=uv, material=material)  # type: ignore[no-untyped-call]
    opaque = np.full((len(colours), 4), 255, dtype=np.uint8)
    opaque[:, :3] = np.rint(255.0 * colours)
    visual.vertex_attributes["color"] = opaque
    return visual
