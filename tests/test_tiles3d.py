"""3D Tiles: GLBs and tilesets are read back by readers written from the specifications."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

import glb_decoder
import terrains
import tileset_reader
from lattices import ArrayLattice
from node import assert_valid_3d_tiles, assert_valid_gltf
from rtin.io.tiles3d import Tiles3D, content, position_step, tileset_files
from rtin.io.tileset import TileRecord
from rtin.schemes import SCHEMES
from rtin.tiles import Tiling, make_tiles, settle_borders

PLACES = {  # scheme, zoom, row and column of the first tile
    "a root": ("geographic", 0, 0, 0),
    "the other root": ("geographic", 0, 0, 1),
    "the north pole": ("geographic", 3, 0, 5),
    "the antimeridian": ("geographic", 9, 200, 1022),
    "a deep zoom": ("geographic", 18, 99999, 300001),
    "the root of Mercator": ("mercator", 0, 0, 0),
    "Mercator's antimeridian": ("mercator", 8, 100, 254),
    "a deep zoom of Mercator": ("mercator", 19, 222222, 111111),
}
everywhere = pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)


def tiles_of(heights, cells, max_error, place):
    """The crack-free tiles of some heights, moved to a place in a scheme."""
    tiling = Tiling.of_raster(ArrayLattice(np.asarray(heights)), cells, max_error)
    made = make_tiles(tiling, tiling.tiles(), settle_borders(tiling).borders)
    _, _, row, col = place
    return [replace(tile, row=tile.row + row, col=tile.col + col) for tile in made]


def some_tiles(place, seed=0):
    """One tile at a root, a few elsewhere."""
    cells = 16 if place[1] == 0 else 8
    return tiles_of(terrains.noise((17, 17), seed), cells, 6.0, place)


def read(tile, place, *, skirt=0.0, step=None):
    return glb_decoder.decode(content(tile, SCHEMES[place[0]], place[1], skirt=skirt, step=step))


def earth_centred(tile, place):
    """Where pyproj says that a tile's vertices are."""
    scheme = SCHEMES[place[0]]
    rows, cols = tile.row * tile.cells + tile.rows, tile.col * tile.cells + tile.cols
    spacing = scheme.spacing(place[1], tile.cells)
    x, y = scheme.west + spacing * cols, scheme.north - spacing * rows
    if scheme.name == "mercator":
        x, y = Transformer.from_crs(3857, 4326, always_xy=True).transform(x, y)
    to_ecef = Transformer.from_crs(4979, 4978, always_xy=True)
    return np.column_stack(to_ecef.transform(x, y, tile.heights))


# --- one tile -----------------------------------------------------------------------------------


@everywhere
def test_vertices_are_where_pyproj_puts_them(place):
    step = position_step(SCHEMES[place[0]], place[1], 100.0)
    assert place[1] < 9 or step < 0.02
    for tile in some_tiles(place):
        found = read(tile, place, step=step).world
        assert np.abs(found - earth_centred(tile, place)).max() <= step / 2 + 1e-6


@everywhere
def test_triangles_face_the_sky_and_are_the_tiles_own(place):
    if place[1] == 0:
        pytest.skip("triangles of half a globe have no side")
    for tile in some_tiles(place):
        found = read(tile, place)
        assert (found.triangles == tile.triangles).all()
        assert "doubleSided" not in found.tree["materials"][0]
        a, b, c = earth_centred(tile, place)[tile.triangles].swapaxes(0, 1)
        facing = (np.cross(b - a, c - a) * a).sum(axis=1)
        smallest = 1e-9 * np.abs(facing).max()  # those at a pole have no area
        assert (facing > -smallest).all()


@pytest.mark.parametrize("name", ["the antimeridian", "Mercator's antimeridian", "a deep zoom"])
@pytest.mark.parametrize(("heights", "tolerance", "skirt"), [
    (terrains.noise((17, 17)), 6.0, 0.0), (terrains.noise((17, 17)), 6.0, 33.3),
    (np.zeros((17, 17)), 0.0, 1.0),
])  # fmt: skip
def test_a_vertex_that_tiles_share_has_one_place_and_one_normal(name, heights, tolerance, skirt):
    place, known, n_common = PLACES[name], {}, 0
    scheme, zoom = SCHEMES[place[0]], place[1]
    step = position_step(scheme, zoom, 200.0)
    n_cols = (scheme.roots << zoom) * 4
    for tile in tiles_of(heights, 4, tolerance, place):
        # The third column of tiles lies beyond the antimeridian.
        tile = replace(tile, col=tile.col % (scheme.roots << zoom))
        found = read(tile, place, skirt=skirt, step=step)
        rows = (tile.row * 4 + np.rint(4 * found.uv[:, 1])).astype(int)
        cols = (tile.col * 4 + np.rint(4 * found.uv[:, 0])).astype(int) % n_cols
        is_low = np.arange(len(rows)) >= len(tile.heights)
        for node, world, normal in zip(
            zip(rows.tolist(), cols.tolist(), is_low.tolist(), strict=True),
            found.world.tolist(), found.normals.tolist(), strict=True,
        ):  # fmt: skip
            n_common += node in known
            assert known.setdefault(node, (world, normal)) == (world, normal)
    assert n_common > 20


def test_the_positions_are_sums_without_rounding():
    place = PLACES["a deep zoom"]
    step = position_step(SCHEMES[place[0]], place[1], 100.0)
    for tile in some_tiles(place):
        multiples = read(tile, place, step=step).world / step
        assert (multiples == np.rint(multiples)).all()


@pytest.mark.parametrize("name", ["a deep zoom", "the antimeridian", "a deep zoom of Mercator"])
def test_normals_stand_on_a_plane_and_so_on_its_triangles(name):
    place = PLACES[name]
    rows, cols = np.mgrid[0:9, 0:9]
    rise = SCHEMES[place[0]].spacing(place[1], 8) * (1 if place[0] == "mercator" else 111_000)
    (tile,) = tiles_of((0.3 * cols - 0.5 * rows) * rise, 8, 0.0, place)
    found = read(tile, place)
    a, b, c = earth_centred(tile, place)[tile.triangles].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for corner in range(3):
        assert np.abs(found.normals[tile.triangles[:, corner]] - normals).max() < 5e-3


@everywhere
def test_skirts_hang_from_the_four_borders_and_close_them(place):
    skirt = 250.0
    for tile in some_tiles(place):
        found, n_own = read(tile, place, skirt=skirt), len(tile.heights)
        hanging = found.triangles[len(tile.triangles) :]
        below = dict(hanging[::2, :2].tolist())  # one below the other
        top, bottom = list(below), list(below.values())
        assert sorted(bottom) == list(range(n_own, len(found.world)))
        sides = (tile.rows[top] % tile.cells == 0) | (tile.cols[top] % tile.cells == 0)
        assert sides.all()
        up = earth_centred(tile, place)[top] - earth_centred(
            replace(tile, heights=tile.heights - skirt), place
        )[top]  # fmt: skip
        step = position_step(SCHEMES[place[0]], place[1], 300.0)
        assert np.abs(found.world[top] - found.world[bottom] - up).max() <= step + 1e-6
        assert (found.normals[top] == found.normals[bottom]).all()
        assert_is_closed_but_for_its_foot(found.triangles, n_own)


def assert_is_closed_but_for_its_foot(triangles, n_own):
    """Every edge runs once each way, but for one ring of edges between lowest vertices."""
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges = set(map(tuple, ends.tolist()))
    assert len(edges) == len(ends)
    alone = {(a, b) for a, b in edges if (b, a) not in edges}
    assert all(a >= n_own and b >= n_own for a, b in alone)
    following = dict(alone)
    start = at = next(iter(following))
    for _ in following:
        at = following[at]
    assert at == start
    assert len(following) == len(set(following.values())) == triangles.max() + 1 - n_own


@given(terrains.rasters(largest=9))
def test_skirts_hang_from_no_hole(raster):
    place = PLACES["a deep zoom"]
    for tile in tiles_of(raster, 4, 3.0, place):
        found = read(tile, place, skirt=5.0)
        edges = {(a, b) for t in tile.triangles.tolist() for a, b in zip(t, t[1:] + t[:1])}  # noqa: B905
        on_side = [
            (a, b)
            for a, b in edges
            if (tile.rows[a] == tile.rows[b] and tile.rows[a] in (0, tile.cells))
            or (tile.cols[a] == tile.cols[b] and tile.cols[a] in (0, tile.cells))
        ]
        assert len(found.triangles) == len(tile.triangles) + 2 * len(on_side)


def test_no_skirt_adds_nothing():
    for tile in some_tiles(PLACES["a deep zoom"]):
        assert len(read(tile, PLACES["a deep zoom"]).world) == len(tile.heights)


@pytest.mark.parametrize(("side", "kind"), [(255, "<u2"), (256, "<u4")])
def test_indices_take_two_bytes_where_they_can(side, kind):
    place = PLACES["a deep zoom"]
    heights = np.random.default_rng(1).normal(0.0, 9.0, (side, side))
    (tile,) = tiles_of(heights, 256, 0.0, place)
    assert len(tile.heights) == side**2
    assert read(tile, place).triangles.dtype == np.dtype(kind)


def test_refuses_a_step_too_small_for_float32():
    tile = some_tiles(PLACES["a root"])[0]
    with pytest.raises(ValueError, match="larger step"):
        read(tile, PLACES["a root"], step=0.25)


# --- tilesets -----------------------------------------------------------------------------------


def tree_of(records, tolerances, scheme="geographic"):
    """The JSON files of some tiles, and the tiles by path as the reader finds them."""
    files = dict(tileset_files(records, tolerances, SCHEMES[scheme]))
    paths = {f"{zoom}/{col}/{row}.glb" for zoom, row, col, _, _ in records}
    return files, tileset_reader.read(files, paths)


@st.composite
def sparse_sets(draw):
    """Any tiles of any zooms, with heights; not always with their parents."""
    scheme = draw(st.sampled_from(sorted(SCHEMES)))
    first = draw(st.integers(0, 7))
    last = first + draw(st.integers(0, 6))
    numbers = st.tuples(st.integers(first, last), st.floats(0, 1, exclude_max=True),
                        st.floats(0, 1, exclude_max=True))  # fmt: skip
    places = set()
    for zoom, y, x in draw(st.lists(numbers, min_size=1, max_size=25)):
        n_rows, n_cols = SCHEMES[scheme].tile_shape(zoom)
        places.add((zoom, int(y * n_rows), int(x * n_cols)))
    heights = st.floats(-400, 8000)
    shuffled = draw(st.permutations(sorted(places)))
    records = [(*place, *sorted((draw(heights), draw(heights)))) for place in shuffled]
    tolerances = {zoom: 3.0 * 2.0 ** (last - zoom) for zoom in range(first, last + 1)}
    return scheme, records, tolerances


@given(sparse_sets())
def test_a_reader_finds_every_tile_of_any_set(case):
    scheme, records, tolerances = case
    _, found = tree_of(records, tolerances, scheme)
    for zoom, row, col, *_ in records:
        tile = found[f"{zoom}/{col}/{row}.glb"]
        assert tile["geometricError"] == tolerances[zoom]
        below = [r for r in records if r[0] >= zoom
                 and (r[1] >> r[0] - zoom, r[2] >> r[0] - zoom) == (row, col)]  # fmt: skip
        *region, lowest, highest = tile["boundingVolume"]["region"]
        assert lowest == min(r[3] for r in below)
        assert highest == max(r[4] for r in below)
        assert np.allclose(region, region_of(scheme, zoom, row, col), rtol=0, atol=1e-9)


def region_of(scheme, zoom, row, col):
    """West, south, east and north of a tile in radians, by pyproj."""
    west, south, east, north = SCHEMES[scheme].bounds(zoom, row, col)
    if scheme == "mercator":
        to_degrees = Transformer.from_crs(3857, 4326, always_xy=True)
        (west, east), (south, north) = to_degrees.transform([west, east], [south, north])
        west, east = -180.0 if col == 0 else west, 180.0 if col + 1 == 1 << zoom else east
    return np.radians([west, south, east, north])


def test_files_do_not_depend_on_the_order_of_the_tiles():
    records = [(zoom, row, col, 0.0, 1.0) for zoom in range(4)
               for row in range(1 << zoom) for col in range(2 << zoom)]  # fmt: skip
    tolerances = dict.fromkeys(range(4), 5.0)
    assert tree_of(records, tolerances)[0] == tree_of(records[::-1], tolerances)[0]


def test_no_file_grows_with_the_terrain():
    def largest(last):
        records = [(zoom, row, col, 0.0, 1.0) for zoom in range(last + 1)
                   for row in range(1 << zoom) for col in range(1 << zoom)]  # fmt: skip
        files, _ = tree_of(records, {zoom: 2.0**-zoom for zoom in range(last + 1)}, "mercator")
        return max(map(len, files.values()))

    assert largest(8) < 1.2 * largest(4) < 120_000


@pytest.mark.parametrize("last", [4, 5, 6, 7, 8])
def test_files_are_few(last):
    records = [(zoom, row, col, 0.0, 1.0) for zoom in range(last + 1)
               for row in range(1 << zoom) for col in range(2 << zoom)]  # fmt: skip
    files, _ = tree_of(records, {zoom: 2.0**-zoom for zoom in range(last + 1)})
    assert len(files) < len(records) / 250


@pytest.mark.parametrize(
    ("scheme", "places"),
    [("geographic", [(2, 0, 1), (4, 3, 4)]), ("mercator", [(3, 2, 1), (5, 10, 4)])],
)
def test_what_is_beyond_the_bounds_of_all_heights_is_in_no_region(scheme, places):
    records = [(*place, 0.0, 1.0) for place in places]
    tolerances = dict.fromkeys(range(6), 9.0)
    bounds = (-130.0, 47.0, -119.0, 51.0)
    files = dict(tileset_files(records, tolerances, SCHEMES[scheme], bounds))
    root = json.loads(files["tileset.json"])["root"]
    assert np.allclose(root["boundingVolume"]["region"][:4], np.radians(bounds))
    paths = {f"{zoom}/{col}/{row}.glb" for zoom, row, col, _, _ in records}
    for path, tile in tileset_reader.read(files, paths).items():
        zoom, col, row = map(int, path.removesuffix(".glb").split("/"))
        whole = region_of(scheme, zoom, row, col)
        low, high = np.radians(bounds[:2] * 2), np.radians(bounds[2:] * 2)
        assert np.allclose(tile["boundingVolume"]["region"][:4], np.clip(whole, low, high))


def test_both_roots_are_under_one_box():
    files, _ = tree_of([(0, 0, 0, 1.0, 2.0), (0, 0, 1, -7.0, 1.0)], {0: 10.0})
    root = json.loads(files["tileset.json"])["root"]
    assert "content" not in root
    assert root["boundingVolume"]["region"] == [
        -np.pi, -np.pi / 2, np.pi, np.pi / 2, -7.0, 2.0]  # fmt: skip
    assert root["geometricError"] > 1e7


def test_begins_at_the_deepest_tile_that_holds_all():
    files, _ = tree_of([(9, 100, 40, 0.0, 1.0), (9, 101, 41, 0.0, 1.0)], {9: 10.0})
    root = json.loads(files["tileset.json"])["root"]
    assert len(files) == 1
    assert len(root["children"]) == 2
    bounds = SCHEMES["geographic"].bounds(8, 50, 20)
    assert np.allclose(root["boundingVolume"]["region"][:4], np.radians(bounds))


def test_boxes_are_opened_where_the_tile_above_would_be():
    records = [(2, 0, 0, 0.0, 1.0), (4, 0, 0, 0.0, 1.0), (4, 3, 3, 0.0, 1.0)]
    files, _ = tree_of(records, {2: 40.0, 3: 20.0, 4: 10.0})
    root = json.loads(files["tileset.json"])["root"]
    boxes = root["children"]
    assert root["geometricError"] == 40.0
    assert [box["geometricError"] for box in boxes] == [40.0, 40.0]
    assert [box["children"][0]["geometricError"] for box in boxes] == [10.0, 10.0]


def test_wants_a_tile():
    with pytest.raises(ValueError, match="at least one tile"):
        tileset_files([], {0: 1.0}, SCHEMES["geographic"])


# --- all together -------------------------------------------------------------------------------


def folder_of(path, place=("geographic", 12, 1000, 2000)):
    """A folder with the 3D Tiles of some terrain at two zooms."""
    scheme, zoom, row, col = place
    fine, coarse = terrains.noise((17, 17)), terrains.noise((17, 17))[::2, ::2]
    output = Tiles3D(scheme, 8, {zoom - 1: 12.0, zoom: 6.0})
    records = []
    for level, heights, error in ((zoom - 1, coarse, 12.0), (zoom, fine, 6.0)):
        shift = 1 << (zoom - level)
        for tile in tiles_of(heights, 8, error, (scheme, level, row // shift, col // shift)):
            data = output.encode(level, tile, float(np.ptp(fine)))
            file = path / output.name(level, tile.row, tile.col)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
            span = float(tile.heights.min()), float(tile.heights.max())
            records.append(TileRecord(level, tile.row, tile.col, len(data), 0, 0, 0.0, *span,
                                      b"", b""))  # fmt: skip
    for name, data in output.index(lambda: iter(records), output.tolerances):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(data)
    return output


@pytest.mark.parametrize("place", [("geographic", 12, 1000, 2000), ("mercator", 4, 6, 8)])
def test_regions_hold_the_tiles_and_their_skirts(tmp_path, place):
    output = folder_of(tmp_path, place)
    files = {"tileset.json": (tmp_path / "tileset.json").read_bytes()}
    paths = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.glb")}
    assert len(paths) == 5
    to_degrees = Transformer.from_crs(4978, 4979, always_xy=True)
    for path, tile in tileset_reader.read(files, paths).items():
        world = glb_decoder.decode((tmp_path / path).read_bytes()).world
        lon, lat, height = to_degrees.transform(*world.T)
        west, south, east, north, low, high = tile["boundingVolume"]["region"]
        slack = 2.0 * output.rounding(int(path.split("/")[0]), 300.0) / 6.3e6
        assert np.radians(lon).min() >= west - slack
        assert np.radians(lon).max() <= east + slack
        assert np.radians(lat).min() >= south - slack
        assert np.radians(lat).max() <= north + slack
        assert low <= height.min()
        assert height.max() <= high


def test_rounding_is_what_positions_may_be_moved_by():
    place = PLACES["the antimeridian"]
    output = Tiles3D(place[0], 8, {9: 6.0})
    for tile in some_tiles(place):
        found = glb_decoder.decode(output.encode(9, tile, 300.0)).world[: len(tile.heights)]
        moved = np.linalg.norm(found - earth_centred(tile, place), axis=1)
        assert moved.max() <= output.rounding(9, 300.0)


def test_skirts_reach_what_lies_two_zooms_apart():
    output = Tiles3D("geographic", 64, {zoom: 8.0 * 2.0**-zoom for zoom in range(16)})
    assert output.skirt(15) >= output.tolerances[15] + output.tolerances[13]
    assert output.skirt(0) >= 2 * output.tolerances[0]


def test_the_gltf_validator_finds_no_fault(tmp_path):
    folder_of(tmp_path)
    assert_valid_gltf(tmp_path.rglob("*.glb"))


@pytest.mark.parametrize("place", [("geographic", 12, 1000, 2000), ("mercator", 9, 100, 200)])
def test_the_3d_tiles_validator_finds_no_fault(tmp_path, place):
    folder_of(tmp_path, place)
    assert_valid_3d_tiles(tmp_path)
