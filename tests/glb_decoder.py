"""A decoder of binary glTF 2.0, from its specification alone, that checks what it reads."""

import json
import struct
from types import SimpleNamespace

import numpy as np

KINDS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def decode(data):
    """Return tree, indices and attributes; ``world`` is what 3D Tiles makes of the positions."""
    magic, version, length, n_text, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    tree = json.loads(data[20 : 20 + n_text])
    n_binary, kind = struct.unpack_from("<I4s", data, 20 + n_text)
    assert kind == b"BIN\0"
    assert n_text % 4 == n_binary % 4 == 0
    binary = data[28 + n_text :]
    assert len(binary) == n_binary == tree["buffers"][0]["byteLength"]
    (node,), (mesh,) = tree["nodes"], tree["meshes"]
    (primitive,) = mesh["primitives"]
    arrays = {name: array(tree, binary, i) for name, i in primitive["attributes"].items()}
    triangles = array(tree, binary, primitive["indices"]).reshape(-1, 3)
    assert triangles.max() < len(arrays["POSITION"])
    assert triangles.max() < np.iinfo(triangles.dtype).max  # which would end a strip
    at = np.array(node.get("translation", [0.0, 0.0, 0.0]))
    read = SimpleNamespace(tree=tree, triangles=triangles, node=at, uv=arrays["TEXCOORD_0"])
    read.world = z_up(at + arrays["POSITION"].astype(float))
    read.normals = z_up(arrays["NORMAL"])
    assert np.allclose(np.linalg.norm(read.normals, axis=1), 1.0, atol=1e-6)
    return read


def array(tree, binary, number):
    accessor = tree["accessors"][number]
    view = tree["bufferViews"][accessor["bufferView"]]
    kind, width = np.dtype(KINDS[accessor["componentType"]]), WIDTHS[accessor["type"]]
    assert view["byteOffset"] % 4 == 0
    assert view["byteLength"] == accessor["count"] * width * kind.itemsize
    values = np.frombuffer(binary, kind, accessor["count"] * width, view["byteOffset"])
    values = values if width == 1 else values.reshape(-1, width)
    if "min" in accessor:
        assert accessor["min"] == values.min(axis=0).tolist()
        assert accessor["max"] == values.max(axis=0).tolist()
    return values


def z_up(points):
    """What 3D Tiles 1.1 does to glTF: y up becomes z up by a quarter turn about x."""
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
