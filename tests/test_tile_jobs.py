"""Jobs of tiles: what their doors refuse, in one line that says what to do."""

import numpy as np
import pytest
import rasterio
from affine import Affine

import rtin
from lattices import ArrayLattice
from rtin.tiles import Tiling


def raster(path, west=500000.0, crs="EPSG:32632"):
    rows, cols = np.mgrid[0:40, 0:50]
    heights = (80 * np.sin(rows / 9) * np.cos(cols / 7)).astype("float32")
    profile = {
        "driver": "GTiff", "count": 1, "dtype": "float32", "height": 40, "width": 50,
        "crs": crs, "transform": Affine(10, 0, west, 0, -10, 5000000.0),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as file:
        file.write(heights, 1)
    return path


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    return raster(tmp_path_factory.mktemp("rasters") / "dem.tif")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"zoom": 5}, TypeError, "zoom must be the first and the last"),
        ({"zoom": (0, 1, 2)}, TypeError, "zoom must be the first and the last"),
        ({"zoom": "0-3"}, TypeError, "zoom must be the first and the last"),
        ({"zoom": (0, 2.5)}, TypeError, "zoom must be the first and the last"),
        ({"zoom": (False, 2)}, TypeError, "zoom must be the first and the last"),
        ({"zoom": (-1, 3)}, ValueError, "zooms must rise within 0 to 24"),
        ({"max_error": 5.0}, TypeError, "max_error must be a list"),
        ({"max_error": "5"}, TypeError, "max_error must be a list"),
        ({"max_error": [float("inf")]}, ValueError, "max_error must be finite"),
        ({"max_error": [float("nan")]}, ValueError, "max_error must be zero or more"),
        ({"error_factor": float("inf")}, ValueError, "error_factor must be finite"),
        ({"error_factor": -1.0}, ValueError, "error_factor must be zero or more, as a multiple"),
        ({"cells": "64"}, TypeError, "cells must be a whole number"),
        ({"cells": True}, TypeError, "cells must be a whole number"),
        ({"fill": float("nan")}, ValueError, "fill must be None or a finite height"),
        ({"fill": "0"}, TypeError, "fill must be a number"),
        ({"normals": "no"}, TypeError, "normals must be True or False"),
        ({"about": ["x"]}, TypeError, "about must be a dict"),
        ({"about": {"cells": "7"}}, ValueError, "about must be 'name'"),
    ],
)
def test_a_globe_is_not_made_of_what_makes_no_sense(dem, options, error, message):
    with pytest.raises(error, match=message) as caught:
        rtin.world_tiles([dem], **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("paths", ["dem.tif", 3, None])
def test_rasters_are_wanted_as_a_list(paths):
    with pytest.raises(TypeError, match="paths must be a list of rasters"):
        rtin.world_tiles(paths)


@pytest.mark.parametrize(
    ("extension", "options", "error", "message"),
    [
        ("xyz", {"max_error": [5.0]}, ValueError, "extension must be 'glb'"),
        (".glb", {"max_error": [5.0]}, ValueError, "extension must be 'glb'"),
        ("glb", {"max_error": []}, ValueError, "max_error is needed"),
        ("glb", {"max_error": 5.0}, TypeError, "max_error must be a list"),
        ("glb", {"max_error": [5.0], "zoom": 0}, TypeError, "zoom must be the first"),
    ],
)
def test_mesh_files_are_not_made_of_what_makes_no_sense(dem, extension, options, error, message):
    with pytest.raises(error, match=message):
        rtin.raster_tiles(dem, extension, **options)


def test_tolerances_may_be_an_array(dem):
    job = rtin.world_tiles([dem], zoom=(0, 2), max_error=np.array([3.0, 2.0, 1.0]))
    assert job.plan.tolerances == {0: 3.0, 1: 2.0, 2: 1.0}


@pytest.mark.parametrize("largest", [0, 3, 32, "4", 2.5])
def test_a_largest_cell_is_a_power_of_two_within_a_tile(largest):
    with pytest.raises(ValueError, match="largest_cell must be None or a power of two up to 16"):
        Tiling(ArrayLattice(np.zeros((17, 17))), 16, 1.0, (1, 1), None, largest)


def test_files_are_not_mixed_with_those_of_a_raster_that_lay_elsewhere(tmp_path):
    dem = raster(tmp_path / "dem.tif")
    rtin.raster_tiles(dem, "obj", max_error=[5.0], cells=16).write(tmp_path / "out")
    raster(dem, west=700000.0)
    moved = rtin.raster_tiles(dem, "obj", max_error=[5.0], cells=16)
    with pytest.raises(FileExistsError, match="made with transform = "):
        moved.write(tmp_path / "out", update=True)
