"""Mesh files of tiles: side by side, they are one mesh."""

import json
from collections import defaultdict

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

import glb_decoder
import rtin
import terrains
from lattices import ArrayLattice
from rtin.io.tile_meshes import PlainMeshes, mesh_of
from rtin.io.tileset import TileRecord
from rtin.tiles import Tiling, make_tiles, settle_borders

TRANSFORMS = {
    "north up": Affine(30.0, 0.0, 512345.678, 0.0, -30.0, 4123456.789),
    "rows run north": Affine(25.0, 0.0, 1e5, 0.0, 12.5, -3e6),
    "rotated": Affine(8.3, 3.1, 700000.1, 2.7, -9.9, 5e6),
}
everywhere = pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=TRANSFORMS)
UTM, DEGREES = CRS.from_epsg(32633), CRS.from_epsg(4326)


def lattice_of(heights, transform=TRANSFORMS["north up"], crs=UTM):
    return ArrayLattice(np.asarray(heights), None, transform, crs)


def tiles_of(lattice, cells=8, max_error=6.0):
    tiling = Tiling.of_raster(lattice, cells, max_error)
    return list(make_tiles(tiling, tiling.tiles(), settle_borders(tiling).borders))


def corners(mesh):
    """The set of triangles, as triples of places."""
    return {tuple(map(tuple, places)) for places in mesh.vertices[mesh.triangles].tolist()}


@everywhere
@pytest.mark.parametrize("shape", [(17, 17), (12, 23)])
def test_the_tiles_are_the_mesh_of_the_whole_raster(transform, shape):
    heights = terrains.noise(shape).astype(np.float32)
    lattice = lattice_of(heights, transform)
    grid = rtin.Grid(heights, transform, UTM)
    keep = np.zeros(shape, bool)
    keep[::8, ::8] = True
    whole = rtin.coarsen(grid, max_error=6.0, keep=keep)
    tiled = [mesh_of(tile, transform, UTM) for tile in tiles_of(lattice)]
    assert set.union(*map(corners, tiled)) == corners(whole)
    for mesh in tiled:
        assert mesh.crs == UTM
        rtin.validity.check(mesh)


@everywhere
@pytest.mark.parametrize("crs", [UTM, DEGREES, None])
@pytest.mark.parametrize("extension", ["glb", "obj", "ply", "stl"])
@pytest.mark.parametrize("local", [False, True])
def test_files_hold_shared_vertices_at_one_place(tmp_path, transform, crs, extension, local):
    if crs is DEGREES:
        transform = Affine(*(value / 1e5 for value in transform[:6]))
    lattice = lattice_of(terrains.noise((17, 17)), transform, crs)
    output = PlainMeshes.of_lattice(lattice, extension, 1, local=local)
    places = defaultdict(set)
    n_vertices = 0
    for tile in tiles_of(lattice):
        vertices = as_in_file(output.encode(1, tile, 100.0), extension, tmp_path)
        nodes = zip(tile.row * 8 + tile.rows, tile.col * 8 + tile.cols, strict=True)
        if extension == "stl":  # which has no vertices, but corners
            nodes = np.array(list(nodes))[tile.triangles.ravel()].tolist()
            nodes = order_of_corners(nodes, output, tile)
        n_vertices += len(tile.heights)
        for node, vertex in zip(nodes, vertices.tolist(), strict=True):
            places[tuple(map(int, node))].add(tuple(vertex))
    assert len(places) < n_vertices
    assert all(len(found) == 1 for found in places.values())


def order_of_corners(nodes, output, tile):
    """STL has the triangles as the mesh has them, which may be turned round."""
    turned = (mesh_of(tile, output.transform).triangles != tile.triangles).any()
    order = [1, 0, 2] if turned else [0, 1, 2]
    return [nodes[3 * i + k] for i in range(len(nodes) // 3) for k in order]


def as_in_file(data, extension, folder):
    """The vertices of a file, as any reader of the format would place them."""
    if extension == "glb":
        return glb_decoder.decode(data).world
    if extension == "stl":
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
        return np.frombuffer(data, record, offset=84)["corners"].reshape(-1, 3)
    if extension == "obj":
        lines = [line.split()[1:] for line in data.decode().splitlines() if line[:2] == "v "]
        return np.array(lines, float)
    head, _, body = data.partition(b"end_header\n")
    count = int(head.split(b"element vertex ")[1].split()[0])
    return np.frombuffer(body, "<f8", 3 * count).reshape(-1, 3)


@everywhere
def test_a_glb_is_off_by_half_a_step_at_most_and_has_the_slopes_normals(transform):
    lattice = lattice_of(terrains.noise((17, 17)).astype(np.float32), transform)
    output = PlainMeshes.of_lattice(lattice, "glb", 1)
    side = 8 * np.abs(np.array(transform[:6]).reshape(2, 3)[:, :2]).sum(axis=1).max()
    known = {}
    for tile in tiles_of(lattice):
        mesh, read = mesh_of(tile, transform), glb_decoder.decode(output.encode(1, tile, 0.0))
        off = np.abs(read.world - mesh.vertices)
        assert off[:, :2].max() <= 2.0**-23 * side / 2
        assert (off[:, 2] == 0.0).all()
        assert (read.triangles == mesh.triangles).all()
        a, b, _, d, e, _ = transform[:6]
        for (to_east, to_north), normal in zip(tile.slopes, read.normals, strict=True):
            # Steps along a column and a row of the lattice lie in the surface.
            assert abs(normal @ [a, d, to_east]) < 1e-5 * np.hypot(a, to_east)
            assert abs(normal @ [-b, -e, to_north]) < 1e-5 * np.hypot(e, to_north)
            assert normal[2] > 0.0
        nodes = zip(tile.row * 8 + tile.rows, tile.col * 8 + tile.cols, strict=True)
        for node, normal in zip(nodes, read.normals.tolist(), strict=True):
            assert known.setdefault(tuple(map(int, node)), normal) == normal


@pytest.mark.parametrize("crs", [UTM, DEGREES])
@pytest.mark.parametrize("extension", ["glb", "obj", "ply"])
def test_reads_back_as_it_was(tmp_path, crs, extension):
    transform = TRANSFORMS["north up"] if crs is UTM else Affine(1e-3, 0, 12.5, 0, -1e-3, 47.1)
    lattice = lattice_of(terrains.noise((17, 17)).astype(np.float32), transform, crs)
    output = PlainMeshes.of_lattice(lattice, extension, 1)
    for tile in tiles_of(lattice):
        path = tmp_path / f"{tile.row}-{tile.col}.{extension}"
        path.write_bytes(output.encode(1, tile, 100.0))
        mesh, found = mesh_of(tile, transform, crs), rtin.read_mesh(path)
        assert found.crs == crs
        assert (found.triangles == mesh.triangles).all()
        assert np.abs(found.vertices - mesh.vertices).max() < 1e-4 * transform.a


@given(terrains.rasters(), st.sampled_from([2, 4, 8]))
def test_any_raster_with_holes_fits_together(raster, cells):
    lattice = lattice_of(raster)
    tiles = tiles_of(lattice, cells, 3.0)
    output = PlainMeshes.of_lattice(lattice, "glb", 5)
    places = {}
    for tile in tiles:
        nodes = zip(tile.row * tile.cells + tile.rows, tile.col * tile.cells + tile.cols,
                    strict=True)  # fmt: skip
        world = glb_decoder.decode(output.encode(5, tile, 0.0)).world.tolist()
        for node, place in zip(nodes, world, strict=True):
            assert places.setdefault(tuple(map(int, node)), place) == place


def test_degrees_become_metres_around_the_middle_of_the_raster():
    lattice = lattice_of(np.zeros((17, 17)), Affine(0.1, 0.0, 12.0, 0.0, -0.1, 60.8), DEGREES)
    output = PlainMeshes.of_lattice(lattice, "glb", 1)
    world = [glb_decoder.decode(output.encode(1, t, 0.0)).world for t in tiles_of(lattice)]
    width, height = np.ptp(np.concatenate(world), axis=0)[:2]
    assert width == pytest.approx(1.6 * 55_800, rel=1e-3)
    assert height == pytest.approx(1.6 * 111_412, rel=1e-3)


def test_coarser_zooms_lie_on_the_nodes_of_the_last():
    heights = terrains.noise((17, 17))
    output = PlainMeshes.of_lattice(lattice_of(heights), "ply", 1)
    (coarse,) = tiles_of(lattice_of(heights[::2, ::2]), 8)
    found = as_in_file(output.encode(0, coarse, 0.0), "ply", None)
    a, _, c, _, e, f = output.transform[:6]
    assert (found[:, 0] == c + a * (2 * coarse.cols)).all()
    assert (found[:, 1] == f + e * (2 * coarse.rows)).all()


def test_tiles_json_lists_the_files():
    output = PlainMeshes.of_lattice(lattice_of(np.zeros((9, 9))), "glb", 1)
    records = [TileRecord(1, 0, col, 99, 4, 2, 0.5, -1.0, 7.0, b"", b"") for col in range(2)]
    ((name, data),) = output.index(lambda: iter(records), {1: 2.0})
    tiles = json.loads(data)
    assert name == "tiles.json"
    assert tiles["crs"] == "EPSG:32633"
    assert tiles["tolerances"] == {"1": 2.0}
    assert [tile["file"] for tile in tiles["tiles"]] == ["1/0/0.glb", "1/1/0.glb"]
    assert {"vertices": 4, "triangles": 2, "error": 0.5}.items() <= tiles["tiles"][1].items()
    ((_, none),) = output.index(lambda: iter([]), {1: 2.0})
    assert json.loads(none)["tiles"] == []


def test_refuses_heights_beyond_float32():
    lattice = lattice_of(np.full((9, 9), 1e39))
    output = PlainMeshes.of_lattice(lattice, "glb", 0)
    with pytest.raises(ValueError, match="32-bit"):
        output.encode(0, tiles_of(lattice)[0], 0.0)
