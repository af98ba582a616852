"""quantized-mesh: every tile is read back by a decoder written from the specification."""

import gzip
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

import quantized_mesh_decoder as decoder
import terrains
from rtin.io import quantized_mesh
from rtin.io.quantized_mesh import encode, gzipped, height_step, rectangles
from rtin.schemes import SCHEMES
from rtin.tiles import Tile, Tiling, make_tiles, settle_borders

PLACES = {  # scheme, zoom, row and column of the first tile
    "a root": ("geographic", 0, 0, 0),
    "the north pole": ("geographic", 3, 0, 5),
    "the south pole": ("geographic", 6, 62, 17),
    "the antimeridian": ("geographic", 9, 200, 1022),
    "a deep zoom": ("geographic", 18, 99999, 300001),
    "the root of Mercator": ("mercator", 0, 0, 0),
    "Mercator's north": ("mercator", 5, 0, 3),
    "Mercator's antimeridian": ("mercator", 8, 100, 254),
    "a deep zoom of Mercator": ("mercator", 19, 222222, 111111),
}
everywhere = pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)


class Heights:
    """A lattice in memory."""

    period = crs = None
    transform = Affine.identity()

    def __init__(self, heights):
        self.heights = np.pad(heights.astype(float), 1, constant_values=np.nan)
        self.rows, self.cols = ((0, n) for n in heights.shape)

    def read(self, rows, cols):
        rows, cols = (np.clip(np.arange(*span), -1, end) + 1 for span, end in
                      ((rows, self.rows[1]), (cols, self.cols[1])))  # fmt: skip
        return np.ascontiguousarray(self.heights[np.ix_(rows, cols)])


def tiles_of(heights, cells, max_error, place=("geographic", 12, 1000, 2000)):
    """The crack-free tiles of some heights, moved to a place in a scheme."""
    tiling = Tiling.of_raster(Heights(heights), cells, max_error)
    made = make_tiles(tiling, tiling.tiles(), settle_borders(tiling).borders)
    _, _, row, col = place
    return [replace(tile, row=tile.row + row, col=tile.col + col) for tile in made]


def encoded(tile, place, step=0.125, **options):
    scheme, zoom = place[:2]
    return encode(tile, SCHEMES[scheme], zoom, step, **options)


def checked(tile, place, step=0.125, **options):
    scheme, zoom = SCHEMES[place[0]], place[1]
    bounds = SimpleNamespace(
        edges=scheme.bounds(zoom, tile.row, tile.col), is_mercator=scheme.name == "mercator"
    )
    return decoder.check(encoded(tile, place, step, **options), bounds)


def by_node(tile, read, place):
    """Decoded height and normal of each node of the world, which must be known exactly."""
    rows = tile.row * tile.cells + rows_of(tile, read.v / decoder.LARGEST, place)
    cols = tile.col * tile.cells + np.rint(tile.cells * read.u / decoder.LARGEST).astype(int)
    octs = read.extensions[decoder.OCT_NORMALS].reshape(-1, 2)
    values = zip(read.heights.tolist(), map(bytes, octs), strict=True)
    return dict(zip(zip(rows.tolist(), cols.tolist(), strict=True), values, strict=True))


def rows_of(tile, shares, place):
    """The rows of nodes at the given shares of the way from the southern latitude up."""
    scheme, zoom = SCHEMES[place[0]], place[1]
    _, south, _, north = scheme.bounds(zoom, tile.row, tile.col)
    if scheme.name == "mercator":
        to_latitude, to_y = (Transformer.from_crs(*pair, always_xy=True).transform
                             for pair in ((3857, 4326), (4326, 3857)))  # fmt: skip
        _, (low, high) = to_latitude([0, 0], [south, north])
        _, y = to_y(np.zeros(len(shares)), low + shares * (high - low))
        shares = (y - south) / (north - south)
    rows = tile.cells * (1 - shares)
    np.testing.assert_allclose(rows, np.rint(rows), rtol=0, atol=tile.cells / 20000)
    return np.rint(rows).astype(int)


def flat(cells, height, slopes=(0.0, 0.0), row=0, col=0):
    """Two triangles."""
    corners = np.array([0, 0, cells, cells], np.int32), np.array([0, cells, 0, cells], np.int32)
    triangles = np.array([[2, 1, 0], [1, 2, 3]], np.int32)
    return Tile(row, col, cells, *corners, np.full(4, float(height)), np.tile(slopes, (4, 1)),
                triangles, 0.0)  # fmt: skip


# --- what a reader decodes ----------------------------------------------------------------------


@everywhere
def test_every_rule_of_the_specification_holds(place):
    heights = terrains.waves((17, 17)) * 20
    for tile in tiles_of(heights, 16 if place[1] == 0 else 8, 30.0, place):
        checked(tile, place)


@given(terrains.rasters(), st.sampled_from([2, 4, 8]), st.sampled_from(sorted(PLACES)))
def test_reads_back_as_the_tile(raster, cells, name):
    place = PLACES[name] if PLACES[name][1] > 4 else ("geographic", 12, 1000, 2000)
    for tile in tiles_of(np.asarray(raster), cells, 4.0, place):
        read = checked(tile, place)
        nodes = by_node(tile, read, place)
        rows, cols = tile.row * tile.cells + tile.rows, tile.col * tile.cells + tile.cols
        assert len(nodes) == len(tile.heights)
        for row, col, height in zip(rows, cols, tile.heights, strict=True):
            assert abs(nodes[row, col][0] - height) <= 0.125 / 2
        assert len(read.triangles) == len(tile.triangles)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("cells", [2, 8])
@pytest.mark.parametrize("tolerance", [2.0, 7.0])
def test_neighbours_decode_their_common_vertices_to_equal_heights_and_normals(
    seed, cells, tolerance
):
    place, known, n_common = PLACES["the antimeridian"], {}, 0
    step = height_step(200.0)
    for tile in tiles_of(terrains.noise((17, 17), seed), cells, 6.0, place):
        for node, value in by_node(tile, checked(tile, place, step), place).items():
            n_common += node in known
            assert known.setdefault(node, value) == value
    assert n_common > 0


def test_normals_are_equal_on_both_sides_of_the_antimeridian():
    for name in ("geographic", "mercator"):
        zoom, cells = 5, 4
        last = SCHEMES[name].tile_shape(zoom)[1] - 1
        slopes = (3.0, -2.0)
        east = checked(flat(cells, 5, slopes, row=9, col=0), (name, zoom))
        west = checked(flat(cells, 5, slopes, row=9, col=last), (name, zoom))
        of_east, of_west = (t.extensions[1].reshape(-1, 2) for t in (east, west))
        for v in (0, decoder.LARGEST):
            here, there = (east.u == 0) & (east.v == v), (west.u > 0) & (west.v == v)
            assert of_east[here].tobytes() == of_west[there].tobytes()


@pytest.mark.parametrize("name", ["geographic", "mercator"])
def test_normals_stand_on_the_decoded_triangles(name):
    zoom, cells, row, col = 14, 4, 4000, 9000
    rise = np.array([40.0, -25.0])  # from node to node
    tile = flat(cells, 0.0, rise, row, col)
    tile.heights[:] = 500 + tile.cols * rise[0] - tile.rows * rise[1]
    read = checked(tile, (name, zoom))
    bounds = SimpleNamespace(
        edges=SCHEMES[name].bounds(zoom, row, col), is_mercator=name == "mercator"
    )
    corners = decoder.earth_centred(read, bounds)[read.triangles]
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    of_faces /= np.linalg.norm(of_faces, axis=1)[:, None]
    cosines = decoder.normals_of(read) @ of_faces.T
    assert cosines.min() > np.cos(np.radians(1.5))  # what bytes and the curvature leave


def test_normals_can_be_left_out():
    assert not checked(flat(4, 0), ("geographic", 3), normals=False).extensions


@pytest.mark.parametrize("cells", [128, 256])
def test_more_vertices_than_two_bytes_can_number(cells):
    place = ("geographic", 10, 300, 900)
    (tile,) = tiles_of(np.random.default_rng(0).normal(size=(cells + 1,) * 2), cells, 0.0, place)
    assert checked(tile, place).triangles.shape == (2 * cells**2, 3)
    assert (len(tile.heights) > 65536) == (cells == 256)


def test_from_the_deepest_sea_to_the_highest_peak():
    heights = np.full((9, 9), -10935.0)
    heights[4, 4] = 8848.86
    place = ("mercator", 7, 40, 100)
    step = height_step(np.ptp(heights))
    (tile,) = tiles_of(heights, 8, 1.0, place)
    read = checked(tile, place, step)
    assert read.heights.min() == -10935.0
    assert abs(read.heights.max() - 8848.86) <= step / 2


@pytest.mark.parametrize("name", ["geographic", "mercator"])
def test_a_hemisphere_has_no_occlusion_point_and_a_small_tile_has_one(name):
    (root,) = tiles_of(terrains.noise((9, 9)), 8, 0.0, (name, 0, 0, 0))
    assert np.isnan(checked(root, (name, 0)).occlusion).all()
    assert not np.isnan(checked(flat(4, 0, row=20, col=9), (name, 6)).occlusion).any()


# --- steps of heights ---------------------------------------------------------------------------


@given(st.floats(0.0, 2e4))
def test_the_step_is_a_power_of_two_that_the_range_fits(largest_range):
    step = height_step(largest_range)
    assert np.frexp(step)[0] == 0.5
    assert largest_range / step + 1 <= 32767


@given(st.floats(-11000.0, 8900.0), st.floats(0.0, 300.0))
def test_any_heights_of_the_earth_fit_the_step_of_their_range(lowest, largest_range):
    tile = flat(2, lowest)
    tile.heights[3] += largest_range
    step = height_step(largest_range)
    read = checked(tile, ("geographic", 10), step)
    assert np.ptp(read.heights) <= largest_range + step


def test_too_fine_a_step_is_refused():
    tile = flat(2, 0)
    tile.heights[0] = 5000.0
    with pytest.raises(ValueError, match=r"differ by 5000 m, more than 32767 steps of 0.125 m"):
        encoded(tile, ("geographic", 10))
    with pytest.raises(ValueError, match="no exact float32 in steps"):
        encoded(flat(2, 8000 + 2.0**-20), ("geographic", 10), 2.0**-20)


# --- files --------------------------------------------------------------------------------------


def test_the_same_tile_is_the_same_file():
    data = encoded(flat(4, 7), ("geographic", 3))
    assert gzipped(data) == gzipped(bytes(data))
    assert gzip.decompress(gzipped(data)) == data
    assert gzipped(data)[4:8] == bytes(4)  # no time


@given(st.sets(st.tuples(st.integers(0, 6), st.integers(0, 6))))
def test_rectangles_cover_each_place_once(places):
    covered = [
        (row, col)
        for first_row, first_col, last_row, last_col in rectangles(places)
        for row in range(first_row, last_row + 1)
        for col in range(first_col, last_col + 1)
    ]
    assert sorted(covered) == sorted(places)


def test_a_full_block_is_one_rectangle():
    assert rectangles((row, col) for row in range(3, 9) for col in range(4)) == [(3, 0, 8, 3)]


def test_tiles_are_named_from_the_south():
    output = quantized_mesh.QuantizedMesh("geographic", True, {}, (0, 0, 1, 1))
    assert output.name(3, 0, 5) == "3/5/7.terrain"
    assert output.roots(0) == {(0, 0), (0, 1)}
    assert output.roots(1) == frozenset()


@pytest.mark.parametrize("exponent", [-10, -3, 2])
@pytest.mark.parametrize("excess", [-3, -2, -1, 0, 1, 2])
def test_a_step_holds_its_range_wherever_the_heights_begin(exponent, excess):
    largest_range = 2.0**exponent * (32767 + excess)
    step = height_step(largest_range)
    assert largest_range / step + 1.0 <= 32767  # rounding both ends may add one
    assert step == 2.0**-10 or largest_range / (step / 2.0) > 32767 - 2
