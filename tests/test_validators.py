"""Whole jobs, read by others' validators and by decoders written from the specifications."""

import gzip
from types import SimpleNamespace

import numpy as np
import pytest

import glb_decoder
import quantized_mesh_decoder
import rtin
import tileset_reader
from islands import write_island
from node import assert_valid_3d_tiles, assert_valid_gltf
from rtin.schemes import SCHEMES

SCHEMES_OF_ALL = pytest.mark.parametrize("scheme", sorted(SCHEMES))


@pytest.fixture(scope="module")
def raster(tmp_path_factory):
    return write_island(tmp_path_factory.mktemp("raster") / "island.tif", shape=(70, 90))


def written(folder, raster, kind, scheme):
    return rtin.world_tiles([raster], kind, scheme=scheme, max_error=[4.0], cells=32).write(folder)


@SCHEMES_OF_ALL
def test_a_decoder_reads_every_tile_of_a_pyramid(tmp_path, raster, scheme):
    summary = written(tmp_path / "tiles", raster, "terrain", scheme)
    paths = sorted((tmp_path / "tiles").rglob("*.terrain"))
    assert len(paths) == sum(level.n_tiles for level in summary.levels) > 20
    for path in paths:
        zoom, x, y = (int(part) for part in path.with_suffix("").parts[-3:])
        edges = SCHEMES[scheme].bounds(zoom, (1 << zoom) - 1 - y, x)
        bounds = SimpleNamespace(edges=edges, is_mercator=scheme == "mercator")
        quantized_mesh_decoder.check(gzip.decompress(path.read_bytes()), bounds)


@SCHEMES_OF_ALL
def test_readers_and_the_gltf_validator_pass_3d_tiles(tmp_path, raster, scheme):
    folder = tmp_path / "tiles"
    written(folder, raster, "3dtiles", scheme)
    glbs = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.glb")}
    files = {path.relative_to(folder).as_posix(): path.read_bytes()
             for path in folder.rglob("*.json") if ".rtin" not in path.parts}  # fmt: skip
    assert len(tileset_reader.read(files, set(glbs))) > 5
    for path in glbs.values():
        assert np.isfinite(glb_decoder.decode(path.read_bytes()).world).all()
    assert_valid_gltf(glbs.values())


@SCHEMES_OF_ALL
def test_the_3d_tiles_validator_passes_3d_tiles(tmp_path, raster, scheme):
    written(tmp_path / "tiles", raster, "3dtiles", scheme)
    assert_valid_3d_tiles(tmp_path / "tiles")


def test_the_validator_passes_mesh_tiles_and_the_mesh_of_a_whole_raster(tmp_path, raster):
    rtin.raster_tiles(raster, "glb", max_error=[4.0], cells=32, zoom=(0, None)).write(
        tmp_path / "tiles"
    )
    mesh = rtin.coarsen(rtin.read_grid(raster), max_error=4.0)
    rtin.write_mesh(mesh, tmp_path / "whole.glb")
    paths = sorted(tmp_path.rglob("*.glb"))
    assert len(paths) > 5
    assert_valid_gltf(paths)
