"""`da.rtin.coarsen_tiles`: arrays of xarray in tiles, computed chunk by chunk."""

import warnings

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import rtin
import terrains
from rtin import Grid, validity
from rtin.io.arrays import DataArrayLattice

xarray = pytest.importorskip("xarray")
dask_array = pytest.importorskip("dask.array")
import rtin.accessor  # noqa: E402


def array_of(heights, **options):
    coords = {
        "y": 90.0 - 10.0 * np.arange(heights.shape[0]),
        "x": 5.0 + np.arange(heights.shape[1]),
    }
    return xarray.DataArray(heights, coords, ("y", "x"), **options)


def terrain(shape=(70, 100)):
    heights = terrains.waves(shape) + terrains.noise(shape) / 32
    return terrains.pierced(heights, terrains.pond(shape))


def corners(shape, cells):
    mask = np.zeros(shape, bool)
    mask[::cells, ::cells] = True
    return mask


def canonical(mesh):
    """Triangles by their corners, in any order."""
    return mesh.vertices.tobytes(), set(map(tuple, mesh.triangles.tolist()))


def assert_is_the_whole_mesh(data, cells, max_error):
    grid = Grid.from_xarray(data)
    whole = rtin.coarsen(grid, max_error=max_error, keep=corners(grid.shape, cells))
    mesh = data.rtin.coarsen_tiles(max_error, cells=cells).mesh()
    assert canonical(mesh) == canonical(whole)
    assert mesh.crs == whole.crs


@given(terrains.rasters(largest=40), terrains.tolerances, st.sampled_from([2, 8, 16]))
def test_tiles_together_are_the_least_mesh_that_keeps_their_corners(heights, max_error, cells):
    assert_is_the_whole_mesh(array_of(heights), cells, max_error)


@pytest.mark.parametrize("chunks", [(70, 100), (16, 16), (23, 7), (1, 100)])
def test_chunks_of_any_shape_make_the_same_mesh(chunks):
    assert_is_the_whole_mesh(
        array_of(terrain()).chunk(dict(zip("yx", chunks, strict=True))), 16, 2.0
    )


@pytest.mark.parametrize("turn", ["transposed", "one band more", "south up"])
def test_arrays_are_laid_out_as_a_grid_would_be(turn):
    data = array_of(terrain()).chunk(20)
    data = {
        "transposed": data.T,
        "one band more": data.expand_dims(band=1),
        "south up": data[::-1],
    }[turn]
    assert_is_the_whole_mesh(data, 16, 2.0)


old_affine = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # in rioxarray


@old_affine
@pytest.mark.parametrize("dtype", ["int16", "uint16", "int32", "float32", "float64"])
@pytest.mark.parametrize("attributes", [{}, {"scale_factor": 0.1, "add_offset": -50.0}])
def test_nodata_scale_and_type_are_those_of_a_grid(dtype, attributes):
    pytest.importorskip("rioxarray")
    heights = np.round(terrains.waves((40, 33)) + 100.0)
    stored = np.where(terrains.pond((40, 33)), 9999, heights).astype(dtype)
    data = array_of(stored, attrs={"_FillValue": 9999, **attributes}).chunk(16)
    assert_is_the_whole_mesh(data.rio.write_crs("EPSG:32628"), 16, 2.0)
    voids = np.isnan(DataArrayLattice(data).read((0, 40), (0, 33)))
    np.testing.assert_array_equal(voids, terrains.pond((40, 33)))


def test_whole_numbers_that_float64_cannot_hold_are_refused():
    data = array_of(np.full((9, 9), 2**62 + 1))
    with pytest.raises(ValueError, match="do not fit float64"):
        data.rtin.coarsen_tiles(1.0).mesh()


def test_every_tile_is_a_right_mesh_and_neighbours_meet():
    tiles = array_of(terrain()).chunk(16).rtin.coarsen_tiles(2.0, cells=16)
    meshes = list(tiles)
    assert len(meshes) == len(tiles.places) == 35
    for mesh, place in zip(meshes, tiles.places, strict=True):
        validity.check(mesh)
        assert canonical(tiles[place]) == canonical(mesh)
    validity.check(tiles.mesh())
    assert sum(mesh.n_triangles for mesh in meshes) == tiles.mesh().n_triangles


def test_a_tile_that_is_not_there_is_a_key_error():
    tiles = array_of(terrain()).rtin.coarsen_tiles(2.0, cells=16)
    with pytest.raises(KeyError, match="no tile with a triangle in row 0, column 7"):
        tiles[0, 7]


def counted(heights, chunk):
    """A Dask array, and a list that gets the place of each chunk as it is computed."""
    computed = []

    def chunk_of(block_info=None):
        place = block_info[None]["chunk-location"]
        computed.append(place)
        (row, end_row), (col, end_col) = block_info[None]["array-location"]
        return heights[row:end_row, col:end_col]

    chunks = tuple((chunk,) * (n // chunk) for n in heights.shape)
    array = dask_array.map_blocks(
        chunk_of, chunks=chunks, dtype=heights.dtype, meta=heights[:0, :0]
    )
    computed.clear()
    return array_of(array), computed


def test_nothing_is_computed_before_it_is_asked_for_and_then_only_what_is_touched():
    data, computed = counted(terrains.waves((96, 96)), 16)
    tiles = data.rtin.coarsen_tiles(2.0, cells=16)
    assert computed == []
    assert len(tiles.places) == 36
    assert set(computed) == set(np.ndindex(6, 6))
    computed.clear()
    tiles[0, 0]
    assert set(computed) == set(np.ndindex(2, 2))


def test_no_more_than_a_row_of_tiles_is_computed_at_once(monkeypatch):
    monkeypatch.setattr(rtin.tiles, "_MOST_READ", 1)
    sizes = []

    class Watched(DataArrayLattice):
        def read(self, rows, cols):
            sizes.append((rows[1] - rows[0]) * (cols[1] - cols[0]))
            return super().read(rows, cols)

    lattice = Watched(array_of(terrain((300, 300))).chunk(64))
    tiles = rtin.accessor.TileMeshes(rtin.tiles.Tiling.of_raster(lattice, 16, 2.0))
    tiles.mesh()
    assert max(sizes) == (16 + 3) * (19 * 16 + 3)


@old_affine
def test_a_file_that_is_opened_lazily_is_read_window_by_window(tmp_path):
    rioxarray = pytest.importorskip("rioxarray")
    heights = terrain().astype("float32")
    grid = Grid(heights, Affine(10, 0, 300, 0, -10, 900), "EPSG:32628")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = xarray.DataArray(
            heights, {"y": 900 - 10.0 * np.arange(70), "x": 300 + 10.0 * np.arange(100)}, ("y", "x")
        )
        data.rio.write_crs("EPSG:32628").rio.to_raster(tmp_path / "a.tif")
        with rioxarray.open_rasterio(tmp_path / "a.tif") as lazy:
            mesh = lazy.rtin.coarsen_tiles(2.0, cells=16).mesh()
    whole = rtin.coarsen(grid, max_error=2.0, keep=corners(grid.shape, 16))
    assert canonical(mesh) == canonical(whole)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"max_error": -1.0}, ValueError, "max_error must be zero or more"),
        ({"max_error": 1.0, "cells": 100}, ValueError, "cells must be a power of two"),
        ({"max_error": "1"}, TypeError, "max_error must be a number"),
    ],
)
def test_refuses_at_once_what_makes_no_tiles(options, error, message):
    with pytest.raises(error, match=message):
        array_of(terrain()).rtin.coarsen_tiles(**options)


def test_refuses_arrays_that_are_no_grids():
    with pytest.raises(ValueError, match="select one band or time first"):
        xarray.DataArray(np.ones((2, 9, 9))).rtin.coarsen_tiles(1.0)
    with pytest.raises(TypeError, match="heights must be real numbers"):
        xarray.DataArray(np.full((9, 9), "a")).rtin.coarsen_tiles(1.0)
    with pytest.raises(ValueError, match="no triangle to keep"):
        array_of(np.full((9, 9), np.nan)).rtin.coarsen_tiles(1.0).mesh()
