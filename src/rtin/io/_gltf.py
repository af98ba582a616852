"""Binary glTF (GLB)."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin import _tint
from rtin.io._placement import PlacedMesh

__all__ = [
    "bounds",
    "encode",
    "glb",
    "lay_over",
    "normals_of",
    "packed",
    "vertex_normals",
    "y_up",
    "z_up",
]

_Floats = NDArray[np.float64]
_Tree = dict[str, Any]

# glTF's numbers for types of components and for what a part of the binary chunk holds.
_COMPONENTS = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}
_ATTRIBUTES, _INDICES = 34962, 34963
# Without mipmaps, which would be made anew for each frame that is sent.
_SMOOTH_WITHIN_EDGES = {"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}
_LONGEST_FILE = 2**32 - 1


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

    Written here because importing trimesh takes longer than all else that writing a small mesh
    does. Solids have no normals: viewers then shade each triangle flat, so that the rim stays
    sharp.
    """
    attributes = {"POSITION": y_up(placed.vertices - shift).astype("<f4")}
    if not placed.is_solid:
        attributes["NORMAL"] = y_up(vertex_normals(placed)).astype("<f4")
    attributes["TEXCOORD_0"] = _texture_coordinates(placed).astype("<f4")
    attributes["COLOR_0"] = _opaque(colours)

    def describe(tree: _Tree) -> None:
        tree["meshes"][0]["extras"] = {"rtin": placed.as_dict()}
        finish(tree)

    return packed(placed.triangles.astype("<u4"), attributes, describe)


def packed(
    triangles: NDArray[np.unsignedinteger[Any]],
    attributes: dict[str, NDArray[Any]],
    finish: Callable[[_Tree], None],
) -> bytes:
    """Return a GLB of triangles and vertices as they are; ``finish`` may change its JSON."""
    arrays = [triangles.ravel(), *attributes.values()]
    parts = [_padded(array.tobytes()) for array in arrays]
    tree = _tree(arrays, [len(part) for part in parts], attributes)
    finish(tree)
    text = json.dumps(tree, separators=(",", ":")).encode("ascii")
    return _container(text, b"".join(parts))


def lay_over(tree: _Tree, jpeg: str, n_bytes: int) -> None:
    """Turn the attribute ``jpeg`` into the picture that TEXCOORD_0 takes the colours from.

    For ``packed``: the attribute, the last one, holds ``n_bytes`` of a JPEG, and up to three more.
    """
    accessor = tree["meshes"][0]["primitives"][0]["attributes"].pop(jpeg)
    view = tree["accessors"].pop(accessor)["bufferView"]
    tree["bufferViews"][view] = {**tree["bufferViews"][view], "byteLength": n_bytes}
    tree["bufferViews"][view].pop("target")
    tree["images"] = [{"bufferView": view, "mimeType": "image/jpeg"}]
    tree["samplers"] = [_SMOOTH_WITHIN_EDGES]
    tree["textures"] = [{"source": 0, "sampler": 0}]
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def _tree(arrays: list[NDArray[Any]], spaces: list[int], names: Iterable[str]) -> _Tree:
    """Return the JSON of a GLB whose binary part is the indices and then each attribute."""
    lengths = [array.nbytes for array in arrays]
    starts = [sum(spaces[:view]) for view in range(len(spaces))]
    attributes = list(names)
    targets = [_INDICES, *[_ATTRIBUTES] * len(attributes)]
    primitive = {
        "attributes": {name: view for view, name in enumerate(attributes, start=1)},
        "indices": 0,
        "material": 0,
    }
    matt = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    return {
        "asset": {"version": "2.0", "generator": "rtin"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "terrain", "mesh": 0}],
        "meshes": [{"name": "terrain", "primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": matt, "doubleSided": True}],
        "accessors": [
            {"bufferView": view, **accessor} for view, accessor in enumerate(map(_accessor, arrays))
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": length, "target": target}
            for start, length, target in zip(starts, lengths, targets, strict=True)
        ],
        "buffers": [{"byteLength": sum(spaces)}],
    }


def _accessor(values: NDArray[Any]) -> _Tree:
    kind = _COMPONENTS[values.dtype.str[1:]]
    shape = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
    accessor = {"componentType": kind, "type": shape, "count": len(values)}
    if values.dtype.kind == "f":
        low, high = bounds(values)
        return {**accessor, "min": low.tolist(), "max": high.tolist()}
    return accessor if values.ndim == 1 else {**accessor, "normalized": True}


def bounds(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the least and the largest of each column, by rows, which is ten times as fast."""
    columns = np.ascontiguousarray(values.T)
    return columns.min(axis=1), columns.max(axis=1)


def _container(text: bytes, binary: bytes) -> bytes:
    """Return a GLB of one JSON chunk, padded to a multiple of four bytes, and one binary one."""
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    if length > _LONGEST_FILE:
        raise ValueError(
            f"a GLB holds at most {_LONGEST_FILE:,} bytes, this mesh would take {length:,}; "
            "write a .ply or a .vtu, or a coarser mesh"
        )
    header = struct.pack("<4sIII4s", b"glTF", 2, length, len(text), b"JSON")
    return b"".join([header, text, struct.pack("<I4s", len(binary), b"BIN\0"), binary])


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
    return normals_of(placed.area_vectors(), placed.triangles, len(placed.vertices))


def normals_of(crosses: _Floats, triangles: NDArray[np.int32], n_vertices: int) -> _Floats:
    """Return what ``vertex_normals`` does, from each triangle's normal as long as its area."""
    numbers = triangles.ravel()
    sums = np.column_stack(
        [np.bincount(numbers, np.repeat(crosses[:, i], 3), n_vertices) for i in range(3)]
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(lengths > 0.0, sums / np.where(lengths > 0.0, lengths, 1.0), [0.0, 0.0, 1.0])


def _texture_coordinates(placed: PlacedMesh) -> _Floats:
    """Return u from west to east and v from north to south, 0 to 1 over the terrain's bounds."""
    (west, south), (east, north) = placed.terrain_bounds[:, :2]
    x, y, _ = placed.vertices.T
    return np.column_stack(
        [(x - west) / ((east - west) or 1.0), (north - y) / ((north - south) or 1.0)]
    )


def _opaque(colours: _Floats) -> NDArray[np.uint8]:
    rgba = np.full((len(colours), 4), 255, dtype=np.uint8)
    rgba[:, :3] = np.rint(255.0 * colours)
    return rgba
