"""Heights of lattices, window by window: rasters' own nodes, and those of tiling schemes."""

import math
import multiprocessing
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyproj
import pytest
import rasterio
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from rtin import Grid, read_grid
from rtin._kernels.lattices import extent
from rtin._raster import moved
from rtin.io._windows import _OPEN, RasterFile
from rtin.io.lattices import GridLattice, RasterLattice, WebLattice, fingerprint, native_zoom
from rtin.schemes import SCHEMES

GEOGRAPHIC, MERCATOR = SCHEMES["geographic"], SCHEMES["mercator"]


def write(path, heights, transform, crs="EPSG:4326", **more):
    heights = np.asarray(heights)
    shape = {"height": heights.shape[0], "width": heights.shape[1]}
    profile = {
        "driver": "GTiff",
        "count": 1,
        "dtype": heights.dtype,
        "crs": crs,
        "transform": transform,
    }
    with rasterio.open(path, "w", **profile, **shape, **more) as dataset:
        dataset.write(heights, 1)
    return path


def moved_cells(transform, cols, rows):
    return Affine(*moved(transform, rows, cols)[:6])


def rough(rows, cols, seed=0):
    return np.random.default_rng(seed).normal(500.0, 100.0, (rows, cols)).astype(np.float32)


def naive(path, lattice, rows, cols):
    """Four samples around every node, one node after the other; for rasters without a ring."""
    grid = read_grid(path)
    way = pyproj.Transformer.from_crs(lattice.crs, grid.crs, always_xy=True)
    found = np.full((rows[1] - rows[0], cols[1] - cols[0]), np.nan)
    for i, row in enumerate(range(*rows)):
        for j, col in enumerate(range(*cols)):
            (x0, y0) = lattice.transform.c, lattice.transform.f
            a, e = lattice.transform.a, lattice.transform.e
            place = grid.places([way.transform(x0 + a * col, y0 + e * row)])[0]
            found[i, j] = bilinear(grid.heights, *place)
    return found


def bilinear(heights, row, col):
    n_rows, n_cols = heights.shape
    if not (
        -0.5 - 1e-6 <= row <= n_rows - 0.5 + 1e-6 and -0.5 - 1e-6 <= col <= n_cols - 0.5 + 1e-6
    ):
        return np.nan
    row, col = np.clip(row, 0, n_rows - 1), np.clip(col, 0, n_cols - 1)
    top, left = math.floor(row), math.floor(col)
    height = 0.0
    for i, share in ((top, 1 - (row - top)), (top + 1, row - top)):
        for j, part in ((left, 1 - (col - left)), (left + 1, col - left)):
            if share * part > 0.0:
                height += share * part * heights[i, j]
    return height


def whole(lattice, margin=2):
    rows, cols = lattice.rows, lattice.cols
    return (rows[0] - margin, rows[1] + margin), (cols[0] - margin, cols[1] + margin)


# Raster, transform of its cells, CRS, scheme, zoom (64 cells a tile): nodes about as close as
# samples, so that they lie at all places between them.
PLACES = {
    "the scheme's own CRS": (
        Affine(0.01, 0, 11.003, 0, -0.012, 46.001),
        "EPSG:4326",
        GEOGRAPHIC,
        8,
    ),
    "mercator": (Affine(1200, 0, 1.2e6, 0, -1300, 5.7e6), "EPSG:3857", GEOGRAPHIC, 8),
    "to mercator": (Affine(0.01, 0, 11.003, 0, -0.012, 46.001), "EPSG:4326", MERCATOR, 9),
    "UTM": (Affine(900, 0, 4e5, 0, -1100, 5.1e6), "EPSG:32632", GEOGRAPHIC, 8),
    "rotated": (Affine(800, 300, 4e5, 400, -900, 5.1e6), "EPSG:32632", MERCATOR, 9),
    "rotated degrees": (Affine(0.01, 0.004, 11, 0.003, -0.01, 46), "EPSG:4326", GEOGRAPHIC, 8),
    "rows from the south": (Affine(0.01, 0, 11.003, 0, 0.012, 45), "EPSG:4326", GEOGRAPHIC, 8),
    "another datum": (Affine(0.01, 0, 11.003, 0, -0.012, 46.001), "EPSG:4258", GEOGRAPHIC, 8),
    "coarse nodes in UTM": (Affine(900, 0, 4e5, 0, -1100, 5.1e6), "EPSG:32632", GEOGRAPHIC, 5),
}


@pytest.mark.parametrize("place", PLACES)
def test_heights_are_bilinear_between_the_samples(tmp_path, place):
    transform, crs, scheme, zoom = PLACES[place]
    heights = rough(45, 38)
    heights[20:23, 7] = -9999
    path = write(tmp_path / "dem.tif", heights, transform, crs, nodata=-9999)
    lattice = WebLattice([path], scheme, zoom, 64)
    rows, cols = whole(lattice)
    found, wanted = lattice.read(rows, cols), naive(path, lattice, rows, cols)
    assert found.dtype == np.float32
    # A hundredth of a cell moves a node next to a void, or next to the edge, to the other side.
    differ = np.isnan(found) != np.isnan(wanted)
    assert differ.sum() <= 2
    assert np.isfinite(wanted).sum() > 20
    assert np.isnan(wanted[1:-1, 1:-1]).any()
    error = np.abs(found - wanted)[~differ]
    # Steepest 800 m in a cell; 0.01 of it were allowed.
    assert np.nanmax(error) < (8.0 if "UTM" in place or place == "rotated" else 1e-3)


@pytest.mark.parametrize("place", PLACES)
def test_the_span_holds_all_nodes_with_heights_and_few_more(tmp_path, place):
    transform, crs, scheme, zoom = PLACES[place]
    path = write(tmp_path / "dem.tif", rough(45, 38), transform, crs)
    lattice = WebLattice([path], scheme, zoom, 64)
    found = np.isfinite(naive(path, lattice, *whole(lattice, 6)))
    inside = found[6:-6, 6:-6]
    assert found.sum() == inside.sum() > 0
    assert inside[:4].any()
    assert inside[-4:].any()
    assert inside[:, :4].any()
    assert inside[:, -4:].any()


@pytest.fixture(scope="module", params=PLACES)
def lattice_and_heights(request, tmp_path_factory):
    transform, crs, scheme, zoom = PLACES[request.param]
    heights = rough(45, 38)
    heights[30, 5:9] = np.nan
    path = write(tmp_path_factory.mktemp("windows") / "dem.tif", heights, transform, crs)
    lattice = WebLattice([path], scheme, zoom, 64)
    return lattice, lattice.read(*whole(lattice, 40))


@settings(max_examples=30)
@given(data=st.data())
def test_a_node_has_the_same_bits_in_every_window(lattice_and_heights, data):
    lattice, heights = lattice_and_heights
    rows, cols = whole(lattice, 40)
    top, bottom = sorted(
        data.draw(st.lists(st.integers(*rows), min_size=2, max_size=2, unique=True))
    )
    left, right = sorted(
        data.draw(st.lists(st.integers(*cols), min_size=2, max_size=2, unique=True))
    )
    found = lattice.read((top, bottom), (left, right))
    wanted = heights[top - rows[0] : bottom - rows[0], left - cols[0] : right - cols[0]]
    assert_array_equal(found.view(np.uint32), wanted.view(np.uint32))


def test_parts_that_fit_memory_give_the_same_bits(tmp_path, monkeypatch):
    path = write(tmp_path / "dem.tif", rough(60, 70), Affine(0.02, 0, 5, 0, -0.02, 50))
    lattice = WebLattice([path], GEOGRAPHIC, 6, 64)
    window = whole(lattice)
    wanted = lattice.read(*window)
    monkeypatch.setattr("rtin.io._mosaic._MOST_SAMPLES", 50)
    monkeypatch.setattr("rtin.io.lattices._MOST_NODES", 40)
    assert_array_equal(lattice.read(*window), wanted)
    assert np.isfinite(wanted).sum() > 100


def test_columns_go_round_the_world(tmp_path):
    path = write(tmp_path / "dem.tif", rough(9, 10), Affine(2.0, 0, 170.0, 0, -2.0, 10.0))
    lattice = WebLattice([path], GEOGRAPHIC, 1, 64)
    assert lattice.period == 256
    heights = lattice.read(lattice.rows, (0, 256))
    assert_array_equal(lattice.read(lattice.rows, (-256, 0)), heights)
    assert_array_equal(lattice.read(lattice.rows, (256, 512)), heights)
    across = lattice.read(lattice.rows, (200, 300))
    assert_array_equal(across, np.hstack([heights[:, 200:], heights[:, :44]]))
    assert np.isfinite(across[:, 50:60]).all()
    assert lattice.cols == (249, 264)


@pytest.mark.parametrize("cell", [2.0, 1.93])  # 1.93 degrees do not divide the world
def test_longitudes_to_360_are_those_to_the_west(tmp_path, cell):
    heights = rough(9, 12)
    east = write(tmp_path / "east.tif", heights, Affine(cell, 0, 230.0, 0, -cell, 10.0))
    west = write(tmp_path / "west.tif", heights, Affine(cell, 0, -130.0, 0, -cell, 10.0))
    one, other = (WebLattice([path], GEOGRAPHIC, 2, 64) for path in (east, west))
    assert (one.rows, one.cols) == (other.rows, other.cols)
    np.testing.assert_allclose(one.read(*whole(one)), other.read(*whole(one)), rtol=1e-5)
    assert np.isfinite(one.read(one.rows, one.cols)).all()


@pytest.mark.parametrize("west", [-180.0, 0.0, 7.0])
def test_a_raster_round_the_world_has_no_seam(tmp_path, west):
    cols = (np.arange(72) * 5.0 + west + 2.5) % 360.0
    heights = np.broadcast_to(100.0 * np.cos(np.radians(cols)), (36, 72)).astype(np.float32)
    path = write(tmp_path / "dem.tif", heights, Affine(5.0, 0, west, 0, -5.0, 90.0))
    lattice = WebLattice([path], GEOGRAPHIC, 2, 64)
    assert (lattice.rows, lattice.cols) == ((0, 257), (0, 512))
    found = lattice.read((0, 257), (-1, 513))
    assert np.isfinite(found).all()
    assert np.abs(np.diff(found, axis=1)).max() < 1.3
    wanted = 100.0 * np.cos(np.radians(np.arange(-1, 513) * 360 / 512 - 180))
    assert np.abs(found - wanted).max() < 0.15


def test_a_utm_raster_lies_on_both_sides_of_the_antimeridian(tmp_path):
    transform = Affine(2000, 0, 1.2e5, 0, -2000, 1.1e5)
    path = write(tmp_path / "dem.tif", rough(40, 60), transform, "EPSG:32601")
    lattice = WebLattice([path], GEOGRAPHIC, 7, 64)
    assert lattice.cols[0] < lattice.period < lattice.cols[1] < lattice.cols[0] + 200
    rows, cols = whole(lattice)
    found, wanted = lattice.read(rows, cols), naive(path, lattice, rows, cols)
    assert np.isfinite(found).sum() > 1000
    assert np.nanmax(np.abs(found - wanted)) < 8.0
    assert (np.isnan(found) != np.isnan(wanted)).sum() <= 4


def test_rasters_on_both_sides_of_the_antimeridian_are_spanned_the_short_way(tmp_path):
    paths = [
        write(tmp_path / f"{west}.tif", rough(8, 4), Affine(2.0, 0, west, 0, -2.0, north))
        for west, north in ((-178, 8.0), (170, 8.7), (-140, 8.3))  # on three grids
    ]
    lattice = WebLattice(paths, GEOGRAPHIC, 1, 64)
    degrees = 256 / 360
    assert lattice.cols == (math.ceil(350 * degrees), math.floor(408 * degrees) + 1)


def test_the_extent_of_places_on_a_ring_is_the_short_way_round():
    assert extent(np.array([[2.0, 98.5, np.nan, 1.0]]), 100) == (-2, 2)
    assert extent(np.array([[2.0, 98.5, np.nan, 1.0]]), 0) == (1, 98)


def test_a_forked_process_opens_files_anew(tmp_path, monkeypatch):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(2, 0, 5, 0, -2, 9))
    file = RasterFile.of(path, 1, None)
    opened = _OPEN.get(file)
    assert _OPEN.get(file) is opened
    monkeypatch.setattr("os.getpid", lambda: -1)
    assert _OPEN.get(file) is not opened


@pytest.mark.parametrize("cell", [0.01, 0.0097])  # 0.0097 degrees do not divide the world
@pytest.mark.parametrize("cut", [20, 1])
def test_abutting_rasters_are_one(tmp_path, cut, cell):
    heights, place = rough(30, 40), Affine(cell, 0, 11.003, 0, -cell, 46.001)
    one = write(tmp_path / "one.tif", heights, place)
    west = write(tmp_path / "west.tif", heights[:, :cut], place)
    east = write(tmp_path / "east.tif", heights[:, cut:], moved_cells(place, cut, 0))
    wanted = WebLattice([one], GEOGRAPHIC, 8, 64)
    found = WebLattice([east, west], GEOGRAPHIC, 8, 64)
    assert (found.rows, found.cols) == (wanted.rows, wanted.cols)
    np.testing.assert_allclose(found.read(*whole(wanted)), wanted.read(*whole(wanted)), atol=1e-2)


def test_the_first_of_two_rasters_counts_and_the_next_fills_its_voids(tmp_path):
    first = np.full((20, 20), 1.0, np.float32)
    first[5:12, 5:12] = np.nan
    a = write(tmp_path / "a.tif", first, Affine(0.01, 0, 11, 0, -0.01, 46))
    b = write(tmp_path / "b.tif", first * 0 + 2, Affine(0.0123, 0, 11.01, 0, -0.01, 46.02))
    c = write(
        tmp_path / "c.tif", np.full((20, 20), 3, np.float32), Affine(0.03, 0, 10.9, 0, -0.03, 46.2)
    )
    lattice = WebLattice([a, b, c], GEOGRAPHIC, 9, 64)
    found = lattice.read(*whole(lattice))
    alone = WebLattice([a], GEOGRAPHIC, 9, 64).read(*whole(lattice))
    assert set(np.unique(found[np.isfinite(found)])) == {1.0, 2.0, 3.0}
    assert_array_equal(found[np.isfinite(alone)], 1.0)


def test_rasters_around_the_world_from_each_other_are_two_where_cells_do_not_divide_it(tmp_path):
    place = Affine(1.93, 0, -170.0, 0, -1.93, 10.0)
    paths = [
        write(tmp_path / f"{col}.tif", rough(9, 12, col), moved_cells(place, col, 0))
        for col in (0, 165)
    ]
    lattice = WebLattice(paths, GEOGRAPHIC, 2, 64)
    for path in paths:
        alone = WebLattice([path], GEOGRAPHIC, 2, 64)
        window = alone.rows, alone.cols
        assert_array_equal(lattice.read(*window), alone.read(*window))


def test_a_sample_void_in_one_raster_comes_from_the_next_on_its_grid(tmp_path):
    heights, place = rough(20, 20), Affine(0.01, 0, 11, 0, -0.01, 46)
    pierced = heights.copy()
    pierced[5:9, 4:8] = np.nan
    paths = [
        write(tmp_path / "pierced.tif", pierced, place),
        write(tmp_path / "part.tif", heights[3:, 2:], moved_cells(place, 2, 3)),
    ]
    lattice = WebLattice(paths, GEOGRAPHIC, 9, 64)
    alone = WebLattice([write(tmp_path / "whole.tif", heights, place)], GEOGRAPHIC, 9, 64)
    np.testing.assert_allclose(lattice.read(*whole(alone)), alone.read(*whole(alone)), atol=1e-2)


@pytest.mark.parametrize("shape", [(1, 12), (12, 1), (1, 1)])
def test_a_single_row_or_column_reaches_to_the_edges_of_its_cells(tmp_path, shape):
    spacing = GEOGRAPHIC.spacing(5, 64)
    heights = rough(*shape)
    place = Affine(4 * spacing, 0, spacing * 98, 0, -4 * spacing, spacing * 52)
    path = write(tmp_path / "dem.tif", heights, place)
    lattice = WebLattice([path], GEOGRAPHIC, 5, 64)
    found = lattice.read(lattice.rows, lattice.cols)
    assert found.shape == (4 * shape[0] + 1, 4 * shape[1] + 1)
    for row, col in np.ndindex(found.shape):
        wanted = bilinear(heights, row / 4 - 0.5, col / 4 - 0.5)
        assert found[row, col] == pytest.approx(wanted, rel=1e-6)


def test_an_l_of_rasters_has_no_hole_at_its_inner_corner(tmp_path):
    place = Affine(0.01, 0, 11.0, 0, -0.01, 46.0)
    paths = [
        write(tmp_path / f"{row}{col}.tif", rough(8, 8), moved_cells(place, 8 * col, 8 * row))
        for row, col in ((0, 0), (0, 1), (1, 0))
    ]
    lattice = WebLattice(paths, GEOGRAPHIC, 11, 64)
    joint = lattice.read(*whole(lattice))
    for path in paths:
        alone = WebLattice([path], GEOGRAPHIC, 11, 64).read(*whole(lattice))
        assert np.isfinite(joint[np.isfinite(alone)]).all()


def test_samples_without_weight_do_not_count(tmp_path):
    spacing = GEOGRAPHIC.spacing(5, 64)
    heights = rough(9, 9)
    heights[4, 4] = np.nan
    corner = Affine(spacing, 0, spacing * (100 - 0.5), 0, -spacing, spacing * (50 + 0.5))
    path = write(tmp_path / "dem.tif", heights, corner)
    lattice = WebLattice([path], GEOGRAPHIC, 5, 64)
    assert_array_equal(lattice.read(lattice.rows, lattice.cols), heights)
    assert lattice.cols == (lattice.period // 2 + 100, lattice.period // 2 + 109)


def test_samples_and_nodes_at_the_poles_and_beyond_mercators_edge(tmp_path):
    path = write(tmp_path / "dem.tif", rough(36, 72), Affine(5.0, 0, -180, 0, -5.0, 90.0))
    assert np.isfinite(WebLattice([path], GEOGRAPHIC, 0, 64).read((0, 65), (0, 128))).all()
    lattice = WebLattice([path], MERCATOR, 0, 64)
    assert (lattice.rows, lattice.cols) == ((0, 65), (0, 64))
    assert np.isfinite(lattice.read((0, 65), (0, 64))).all()
    assert np.isnan(lattice.read((-3, 0), (0, 64))).all()


def test_a_polar_raster_holds_the_pole(tmp_path):
    path = write(
        tmp_path / "dem.tif", rough(40, 40), Affine(1e5, 0, -2e6, 0, -1e5, 2e6), "EPSG:3031"
    )
    lattice = WebLattice([path], GEOGRAPHIC, 1, 64)
    assert lattice.rows[1] == 129
    assert lattice.cols == (0, 256)
    assert np.isfinite(lattice.read((125, 129), (0, 256))).all()


def test_z_scale_turns_feet_into_metres(tmp_path):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(0.01, 0, 11, 0, -0.01, 46))
    feet = WebLattice([path], GEOGRAPHIC, 9, 64)
    metres = WebLattice([path], GEOGRAPHIC, 9, 64, z_scale=0.3048)
    window = feet.rows, feet.cols
    np.testing.assert_allclose(metres.read(*window), feet.read(*window) * 0.3048, rtol=1e-6)


def test_a_geoid_without_grid_is_refused_by_name(tmp_path, monkeypatch):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(0.01, 0, 11, 0, -0.01, 46))
    with pytest.raises(ValueError, match=r"us_nga_egm96_15\.tif.*pyproj sync --file"):
        WebLattice([path], GEOGRAPHIC, 9, 64, geoid="egm96")
    with pytest.raises(ValueError, match="geoid must be"):
        WebLattice([path], GEOGRAPHIC, 9, 64, geoid="egm84")


def test_the_geoids_height_is_added(tmp_path, monkeypatch):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(0.01, 0, 11, 0, -0.01, 46))
    monkeypatch.setattr("rtin.io.lattices.require_geoid", lambda _: None)
    monkeypatch.setattr("rtin.io.lattices.undulation", lambda _, lon, lat: (lon + 2 * lat,))
    plain = WebLattice([path], GEOGRAPHIC, 9, 64)
    raised = WebLattice([path], GEOGRAPHIC, 9, 64, geoid="egm2008")
    rows, cols = plain.rows, plain.cols
    lon, lat = plain.nodes.longitudes(np.arange(*cols)), plain.nodes.latitudes(np.arange(*rows))
    wanted = plain.read(rows, cols) + lon + 2 * lat[:, None]
    np.testing.assert_allclose(raised.read(rows, cols), wanted, atol=1e-3)


def test_heights_above_the_ellipsoid_get_no_geoid(tmp_path):
    place = Affine(0.01, 0, 11, 0, -0.01, 46)
    path = write(tmp_path / "dem.tif", rough(9, 9), place, pyproj.CRS("EPSG:4979").to_wkt())
    plain = WebLattice([path], GEOGRAPHIC, 9, 64)
    raised = WebLattice([path], GEOGRAPHIC, 9, 64, geoid="egm2008")
    window = plain.rows, plain.cols
    assert_array_equal(raised.read(*window), plain.read(*window))


def test_a_raster_without_crs_is_refused(tmp_path):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(1, 0, 5, 0, -1, 5), None)
    with pytest.raises(ValueError, match=r"dem\.tif has no CRS; "):
        WebLattice([path], GEOGRAPHIC, 9, 64)
    with pytest.raises(ValueError, match="at least one raster"):
        WebLattice([], GEOGRAPHIC, 9, 64)


def test_a_raster_of_the_moon_is_refused(tmp_path):
    lunar = pyproj.CRS("IAU_2015:30100").to_wkt()
    path = write(tmp_path / "moon.tif", rough(9, 9), Affine(1, 0, 5, 0, -1, 5), lunar)
    with pytest.raises(ValueError, match="a CRS on Earth is wanted"):
        WebLattice([path], GEOGRAPHIC, 2, 64)


@pytest.mark.parametrize(
    ("place", "crs"),
    [
        (Affine(30, 0, 4e5, 0, -30, 5e6), "EPSG:4326"),  # metres taken for degrees
        (Affine(900, 0, 4e9, 0, -900, 5e12), "EPSG:32632"),
    ],
)
def test_a_raster_nowhere_on_earth_is_named_with_its_crs(tmp_path, place, crs):
    path = write(tmp_path / "dem.tif", rough(9, 9), place, crs)
    name = pyproj.CRS(crs).name
    for make in (
        lambda: WebLattice([path], GEOGRAPHIC, 9, 64),
        lambda: native_zoom([path], MERCATOR, 64),
    ):
        with pytest.raises(
            ValueError, match=rf"dem\.tif lies nowhere .* {name}; give it"
        ) as raised:
            make()
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("north", [89.0, -87.0])
def test_a_raster_beyond_the_scheme_is_refused(tmp_path, north):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(0.1, 0, 5, 0, -0.1, north))
    with pytest.raises(ValueError, match=r"dem\.tif lies beyond the scheme 'mercator'.*85\.05"):
        WebLattice([path], MERCATOR, 3, 64)


def test_a_raster_between_two_nodes_has_none(tmp_path):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(0.1, 0, 5.7, 0, -0.1, 1.3))
    lattice = WebLattice([path], MERCATOR, 0, 64)
    assert lattice.rows[0] == lattice.rows[1]
    assert np.isnan(lattice.read((0, 65), (0, 64))).all()


def test_the_native_zoom_is_the_nearest_to_as_fine(tmp_path):
    for arcseconds, zoom in ((3, 12), (1, 13), (0.88, 13), (0.87, 14), (180 * 3600 / 64, 0)):
        step = arcseconds / 3600
        path = write(tmp_path / "dem.tif", rough(4, 4), Affine(step, 0, 7, 0, -step, 46))
        assert native_zoom([path], GEOGRAPHIC, 64) == zoom
    spacing = MERCATOR.spacing(9, 64)
    path = write(
        tmp_path / "m.tif", rough(4, 4), Affine(spacing, 0, 7, 0, -spacing, 46), "EPSG:3857"
    )
    assert native_zoom([path], MERCATOR, 64) == 9


def test_around_a_pole_the_native_zoom_is_that_of_metres(tmp_path):
    across = Affine(300, 0, -45000, 0, -300, 30000)
    path = write(tmp_path / "pole.tif", rough(200, 300), across, "EPSG:3031")
    assert native_zoom([path], GEOGRAPHIC, 64) == 10  # 305 m from node to node


@pytest.mark.parametrize("dtype", ["int16", "float32", "float64", "int32"])
def test_a_raster_lattice_is_what_read_grid_reads(tmp_path, dtype):
    heights = rough(40, 50).astype(dtype)
    path = write(tmp_path / "dem.tif", heights, Affine(2, 0, 5, 0, -2, 9), "EPSG:32632")
    lattice, grid = RasterLattice(path), read_grid(path)
    assert (lattice.rows, lattice.cols, lattice.period) == ((0, 40), (0, 50), None)
    assert lattice.transform == grid.transform
    assert lattice.crs == grid.crs
    assert_array_equal(lattice.read((0, 40), (0, 50)), grid.heights)
    around = lattice.read((-3, 12), (45, 53))
    assert around.dtype == ("float32" if dtype in ("int16", "float32") else "float64")
    assert_array_equal(around[3:, :5], grid.heights[:12, 45:])
    assert np.isnan(around[:3]).all()
    assert np.isnan(around[:, 5:]).all()
    assert np.isnan(lattice.read((90, 95), (0, 2))).all()
    assert_array_equal(GridLattice(grid).read((-3, 12), (45, 53)), around)


def test_voids_scales_and_colours_are_read_as_read_grid_reads_them(tmp_path):
    path = write(
        tmp_path / "a.tif", rough(8, 9).astype("int16"), Affine(2, 0, 5, 0, -2, 9), nodata=500
    )
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.1,), (7.0,)
    assert_array_equal(RasterLattice(path).read((0, 8), (0, 9)), read_grid(path).heights)
    codes = ((rough(8, 9).astype(float) + 10000) * 10).astype(int)
    bands = np.stack([codes >> 16, codes >> 8 & 255, codes & 255]).astype(np.uint8)
    profile = {"driver": "GTiff", "height": 8, "width": 9, "count": 3, "dtype": "uint8"}
    profile |= {"crs": "EPSG:4326", "transform": Affine(2, 0, 5, 0, -2, 9)}
    with rasterio.open(tmp_path / "c.tif", "w", **profile) as dataset:
        dataset.write(bands)
    lattice = RasterLattice(tmp_path / "c.tif")
    assert lattice.file.encoding == "terrain-rgb"
    assert_array_equal(lattice.read((2, 8), (1, 9)), read_grid(tmp_path / "c.tif").heights[2:, 1:])


def test_an_array_in_a_file_is_a_lattice(tmp_path):
    np.save(tmp_path / "dem.npy", rough(8, 9).astype(np.float64))
    lattice = pickle.loads(pickle.dumps(RasterLattice(tmp_path / "dem.npy")))
    found = lattice.read((2, 9), (0, 4))
    assert found.dtype == np.float64
    assert_array_equal(found[:6], rough(8, 9)[2:, :4])
    assert np.isnan(found[6]).all()


def test_a_damaged_block_names_the_file_and_the_window(tmp_path):
    options = {"tiled": True, "blockxsize": 64, "blockysize": 64, "compress": "deflate"}
    path = write(tmp_path / "dem.tif", rough(256, 256), Affine(2, 0, 5, 0, -2, 9), **options)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 4000] = bytes(4000)
    path.write_bytes(data)
    lattice = RasterLattice(path)
    with pytest.raises(OSError, match=r"dem\.tif.*rows 64 to 192, columns 0 to 256"):
        lattice.read((64, 192), (0, 256))


def test_infinite_heights_are_refused(tmp_path):
    heights = rough(9, 9)
    heights[3, 3] = np.inf
    path = write(tmp_path / "dem.tif", heights, Affine(2, 0, 5, 0, -2, 9))
    with pytest.raises(ValueError, match=r"dem\.tif: heights must be finite"):
        RasterLattice(path).read((0, 9), (0, 9))


def test_threads_and_copies_read_the_same(tmp_path):
    path = write(tmp_path / "dem.tif", rough(90, 90), Affine(0.01, 0, 11, 0, -0.01, 46))
    lattice = WebLattice([path], GEOGRAPHIC, 9, 64)
    copy = pickle.loads(pickle.dumps(lattice))
    wanted = lattice.read(*whole(lattice))
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda each: each.read(*whole(lattice)), [lattice, copy] * 8):
            assert_array_equal(found, wanted)


def test_a_raster_written_anew_is_read_anew(tmp_path):
    place = Affine(2, 0, 5, 0, -2, 9)
    path = write(tmp_path / "dem.tif", rough(9, 9), place)
    before = fingerprint([path])
    RasterLattice(path).read((0, 9), (0, 9))
    assert fingerprint([path]) == before
    path.unlink()
    write(path, rough(9, 9, seed=1), place, compress="deflate")
    assert fingerprint([path]) != before
    assert_array_equal(RasterLattice(path).read((0, 9), (0, 9)), rough(9, 9, seed=1))


def test_a_fingerprint_follows_the_sources_of_a_vrt(tmp_path):
    path = write(tmp_path / "dem.tif", rough(9, 9), Affine(2, 0, 5, 0, -2, 9))
    (tmp_path / "dem.vrt").write_text(
        '<VRTDataset rasterXSize="9" rasterYSize="9"><VRTRasterBand dataType="Float32" band="1">'
        '<SimpleSource><SourceFilename relativeToVRT="1">dem.tif</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    before = fingerprint([tmp_path / "dem.vrt"])
    write(path, rough(9, 9), Affine(2, 0, 5, 0, -2, 9), compress="deflate")
    assert fingerprint([tmp_path / "dem.vrt"]) != before


def test_a_forked_process_reads_a_raster_that_its_parent_has_open(tmp_path):
    heights = rough(200, 300)
    lattice = RasterLattice(write(tmp_path / "dem.tif", heights, Affine(0.1, 0, 5, 0, -0.1, 9)))
    lattice.read((0, 200), (0, 300))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        theirs = pool.apply_async(lattice.read, ((0, 200), (0, 300)))
        assert_array_equal(theirs.get(timeout=60), heights)


def test_a_grid_with_voids_pads_with_voids():
    lattice = GridLattice(Grid([[1.0, np.nan], [3.0, 4.0]]))
    found = pickle.loads(pickle.dumps(lattice)).read((-1, 3), (0, 3))
    assert_array_equal(np.isfinite(found).sum(), 3)
