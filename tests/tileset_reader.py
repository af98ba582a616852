"""A reader of 3D Tiles 1.1 tilesets, from the specification alone, that checks what it reads."""

import json
import posixpath
from math import pi

EPSILON = 1e-12


def read(files, contents):
    """Return {path of a GLB: its tile}, following external tilesets; every file must be used.

    ``files`` are the JSON files by path, ``contents`` the paths of the GLBs.
    """
    found, used = {}, set()
    visit_file("tileset.json", None, files, contents, found, used)
    assert used == set(files)
    assert set(found) == set(contents)
    return found


def visit_file(path, above, files, contents, found, used):
    assert path not in used
    used.add(path)
    tileset = json.loads(files[path])
    assert tileset["asset"]["version"] == "1.1"
    root = tileset["root"]
    assert root["refine"] == "REPLACE"
    assert tileset["geometricError"] >= root["geometricError"]
    if above is not None:
        assert tileset["geometricError"] == above["geometricError"]
        assert root["boundingVolume"] == above["boundingVolume"]
    visit(root, above, path, files, contents, found, used)


def visit(tile, above, path, files, contents, found, used):
    assert set(tile) <= {"boundingVolume", "geometricError", "refine", "content", "children"}
    require_region(tile["boundingVolume"]["region"])
    assert tile["geometricError"] >= 0.0
    if above is not None:
        assert tile["geometricError"] <= above["geometricError"]
        require_within(tile["boundingVolume"]["region"], above["boundingVolume"]["region"])
    assert "content" in tile or tile["children"]
    if "content" in tile:
        uri = posixpath.normpath(posixpath.join(posixpath.dirname(path), tile["content"]["uri"]))
        if uri.endswith(".json"):
            assert "children" not in tile
            visit_file(uri, tile, files, contents, found, used)
            return
        assert uri in contents
        assert uri not in found
        found[uri] = tile
    for child in tile.get("children", []):
        visit(child, tile, path, files, contents, found, used)


def require_region(region):
    west, south, east, north, low, high = region
    assert -pi <= west < east <= pi
    assert -pi / 2 <= south < north <= pi / 2
    assert low <= high


def require_within(inner, outer):
    for i in (0, 1, 4):
        assert inner[i] >= outer[i] - EPSILON
    for i in (2, 3, 5):
        assert inner[i] <= outer[i] + EPSILON
