"""A web page to turn a terrain in: one file that needs no network."""

from __future__ import annotations

import base64
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from rtin import _tint
from rtin.io import _gltf
from rtin.io._placement import PlacedMesh

__all__ = ["page"]

_FIELD_OF_VIEW = np.radians(40.0)
_ELEVATION = np.radians(35.0)
_CAPTION = (
    '<div style="position:fixed;left:12px;bottom:10px;font:13px sans-serif;color:#555;'
    'pointer-events:none">{counts} · drag to turn, wheel to zoom, right button to move, '
    "W for the triangles</div>"
)
_WIREFRAME = (
    '<script>addEventListener("keydown",function(e){if(e.key.toLowerCase()!=="w")return;'
    "scene.traverse(function(o){if(o.material)o.material.wireframe=!o.material.wireframe});"
    "render()})</script>"
)


def page(placed: PlacedMesh, note: str = "") -> bytes:
    """Return an HTML page that shows ``placed`` and holds all it needs, three.js too.

    The counts and the note are at its foot.

    The page is trimesh's viewer. Its only light sits at the camera and shows no relief, so the
    light is part of the colours here and the material is unlit.
    """
    counts = f"{len(placed.triangles):,} triangles, {len(placed.vertices):,} vertices"
    head, body = _template().split("$B64GLTF")
    head = re.sub("<title>.*?</title>", f"<title>rtin: {counts}</title>", head, count=1)
    head = head.replace("<body>", "<body>" + _CAPTION.format(counts=counts + note), 1)
    body = body.replace("</body>", _WIREFRAME + "</body>", 1)
    return head.encode() + base64.b64encode(_unlit_glb(placed)) + body.encode()


def _template() -> str:
    """Return trimesh's viewer, three.js and all, without the time that importing trimesh takes."""
    found = find_spec("trimesh")
    assert found is not None, "trimesh is required"
    assert found.origin is not None, "trimesh is a folder with an __init__.py"
    archive = Path(found.origin).parent / "resources" / "templates" / "viewer.zip"
    with ZipFile(archive) as files:
        return files.read("viewer.html.template").decode("utf-8")


def _unlit_glb(placed: PlacedMesh) -> bytes:
    low, high = placed.terrain_bounds[:, 2]
    light = _tint.hillshade(_gltf.vertex_normals(placed))
    # The page shows vertex colours as they are, without the conversion from linear to sRGB.
    colours = _tint.tint(placed.vertices[:, 2], low, high) * (0.3 + light[:, np.newaxis]).clip(0, 1)
    radius = float(np.linalg.norm(np.ptp(placed.terrain_bounds, axis=0))) / 2.0 or 1.0

    def finish(tree: dict[str, Any]) -> None:
        tree["extensionsUsed"] = ["KHR_materials_unlit"]
        tree["materials"][0]["extensions"] = {"KHR_materials_unlit": {}}
        tree["cameras"] = [_camera(radius)]
        tree["nodes"].append(_camera_node(radius))
        tree["scenes"][0]["nodes"].append(1)

    return _gltf.encode(placed, placed.terrain_bounds.mean(axis=0), colours, finish)


def _camera(radius: float) -> dict[str, Any]:
    lens = {"yfov": _FIELD_OF_VIEW, "znear": radius / 100.0, "zfar": radius * 100.0}
    return {"type": "perspective", "perspective": lens}


def _camera_node(radius: float) -> dict[str, Any]:
    """Return a camera south of the middle that looks down on it, in glTF's axes (y up, z south)."""
    distance = 0.72 * radius / np.sin(_FIELD_OF_VIEW / 2.0)
    position = distance * np.array([0.0, np.sin(_ELEVATION), np.cos(_ELEVATION)])
    tilt = [-np.sin(_ELEVATION / 2.0), 0.0, 0.0, np.cos(_ELEVATION / 2.0)]
    return {"camera": 0, "translation": position.tolist(), "rotation": tilt}
