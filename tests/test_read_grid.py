"""Reading rasters: exact heights, every kind of void, the right place, and one-line errors."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rasterio._err import CPLE_BaseError
from rasterio.control import GroundControlPoint
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.windows import Window

from rtin import Grid, _raster
from rtin.io import _thinning, grids
from rtin.io._thinning import _taken
from rtin.io.grids import read_grid, suspicious_values

PLACE = Affine(10.0, 0.0, 1000.0, 0.0, -20.0, 9000.0)
RAMP = np.arange(20.0).reshape(4, 5)


def write_raster(path, bands, *, driver="GTiff", transform=PLACE, crs="EPSG:32628", **more):
    """Write one band (2-D) or several (3-D); ``mask`` and ``tags`` are written, too."""
    bands = np.atleast_3d(np.asarray(bands).T).T
    mask, tags, colorinterp, scale = (
        more.pop(key, None) for key in ("mask", "tags", "colorinterp", "scale")
    )
    colormap = more.pop("colormap", None)
    profile = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    place = {"crs": crs} if "gcps" in more else {}
    if transform is not None:
        place = {"transform": transform, "crs": crs}
    with warnings.catch_warnings(), rasterio.Env(GDAL_TIFF_INTERNAL_MASK="YES"):
        warnings.simplefilter("ignore")
        with rasterio.open(
            path, "w", driver=driver, dtype=bands.dtype, **profile, **place, **more
        ) as file:
            if colorinterp is not None:
                file.colorinterp = colorinterp
            file.write(bands)
            if colormap is not None:
                file.write_colormap(1, colormap)
            if mask is not None:
                file.write_mask(mask)
            if scale is not None:
                file.scales, file.offsets = ([value] * len(bands) for value in scale)
            file.update_tags(**(tags or {}))
    return path


def write_vrt(path, band, rows=4, cols=5):
    path.write_text(
        f"<VRTDataset rasterXSize='{cols}' rasterYSize='{rows}'>"
        f"<VRTRasterBand dataType='Byte' band='1'>{band}</VRTRasterBand></VRTDataset>"
    )
    return path


def vrt_source(band, row=0, col=0, rows=4, cols=5):
    size = f"xSize='{cols}' ySize='{rows}'"
    return (
        "<SimpleSource><SourceFilename relativeToVRT='1'>a.tif</SourceFilename>"
        f"<SourceBand>{band}</SourceBand><SrcRect xOff='{col}' yOff='{row}' {size}/>"
        f"<DstRect xOff='0' yOff='0' {size}/></SimpleSource>"
    )


def encode(heights, scale, offset):
    codes = np.round((heights - offset) / scale).astype(np.int64)
    return np.stack([codes >> 16, codes >> 8 & 255, codes & 255]).astype(np.uint8)


def one_line(error):
    return len(str(error.value).splitlines()) == 1


# Heights


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16", "float32"])
def test_narrow_heights_come_as_the_same_float32(tmp_path, dtype):
    grid = read_grid(write_raster(tmp_path / "a.tif", RAMP.astype(dtype)))
    assert grid.heights.dtype == np.float32
    np.testing.assert_array_equal(grid.heights, RAMP)


@pytest.mark.parametrize("dtype", ["int32", "uint32", "int64", "uint64", "float64"])
def test_wide_heights_come_as_float32_only_where_that_is_exact(tmp_path, dtype):
    exact = read_grid(write_raster(tmp_path / "a.tif", RAMP.astype(dtype)))
    finer = (RAMP + 2**24 + 1).astype(dtype)
    kept = read_grid(write_raster(tmp_path / "b.tif", finer))
    assert (exact.heights.dtype, kept.heights.dtype) == (np.float32, np.float64)
    np.testing.assert_array_equal(kept.heights, finer)


def test_integers_too_large_for_float64_are_refused(tmp_path):
    path = write_raster(tmp_path / "a.tif", (RAMP + 1).astype(np.int64) * 2**60 // 20)
    with pytest.raises(ValueError, match=r"a\.tif: heights must be less than 2\*\*53"):
        read_grid(path)


def test_scale_and_offset_are_applied_and_stay_float32(tmp_path):
    stored = RAMP.astype(np.int16)
    grid = read_grid(write_raster(tmp_path / "a.tif", stored, nodata=7, scale=(0.1, -500.0)))
    expected = np.where(stored == 7, np.nan, stored * 0.1 - 500.0).astype(np.float32)
    assert grid.heights.dtype == np.float32
    np.testing.assert_array_equal(grid.heights, expected)


def test_scaled_float64_is_rounded_to_float32_once(tmp_path):
    stored = RAMP / 3.0
    grid = read_grid(write_raster(tmp_path / "a.tif", stored, scale=(0.3048, 1.0)))
    np.testing.assert_array_equal(grid.heights, (stored * 0.3048 + 1.0).astype(np.float32))


def test_reads_the_band_asked_for(tmp_path):
    path = write_raster(tmp_path / "a.tif", np.stack([RAMP, RAMP + 100]).astype(np.float32))
    np.testing.assert_array_equal(read_grid(path, band=2).heights, RAMP + 100)


@pytest.mark.parametrize("band", [1.0, True, "1", None, (1,), np.array([1, 2])])
@pytest.mark.parametrize("name", ["a.tif", "a.npy"])
def test_a_band_is_a_whole_number(tmp_path, name, band):
    with pytest.raises(TypeError, match="band must be a whole number from 1, got") as error:
        read_grid(tmp_path / name, band=band)
    assert one_line(error)


@pytest.mark.parametrize("integer", [np.int64, np.uint8])
def test_a_band_may_be_an_integer_of_numpy(tmp_path, integer):
    path = write_raster(tmp_path / "a.tif", np.stack([RAMP, RAMP + 100]).astype(np.float32))
    np.testing.assert_array_equal(read_grid(path, band=integer(2)).heights, RAMP + 100)


# Voids


@pytest.mark.parametrize(
    ("dtype", "nodata"),
    [
        ("int16", -32768),
        ("uint8", 255),
        ("int32", 2**31 - 1),
        ("int64", -9999),
        ("float32", -9999.0),
        ("float32", -3.4e38),
        ("float32", -3.4028234663852886e38),
        ("float32", float("nan")),
        ("float32", float("inf")),
        ("float64", -1.7976931348623157e308),
    ],
)
def test_nodata_is_void_as_the_band_stores_it(tmp_path, dtype, nodata):
    stored = RAMP.astype(dtype)
    stored[1, 2] = nodata
    grid = read_grid(write_raster(tmp_path / "a.tif", stored, nodata=nodata))
    expected = RAMP.copy()
    expected[1, 2] = np.nan
    assert grid.heights.dtype == np.float32
    np.testing.assert_array_equal(grid.heights, expected)


def test_nodata_mask_and_nan_are_combined(tmp_path):
    stored = RAMP.astype(np.float32)
    stored[0, 0], stored[1, 1] = -9999.0, np.nan
    shown = np.full(RAMP.shape, True)
    shown[2, 2] = False
    path = write_raster(tmp_path / "a.tif", stored, nodata=-9999.0, mask=shown)
    expected = RAMP.copy()
    expected[[0, 1, 2], [0, 1, 2]] = np.nan
    np.testing.assert_array_equal(read_grid(path).heights, expected)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_an_alpha_band_hides_samples_beside_nodata(tmp_path, dtype):
    alpha = np.full(RAMP.shape, 200)
    alpha[3, 4] = 0
    path = write_raster(
        tmp_path / "a.tif",
        np.stack([RAMP, alpha]).astype(dtype),
        nodata=5,
        colorinterp=[ColorInterp.gray, ColorInterp.alpha],
    )
    expected = RAMP.copy()
    expected[[1, 3], [0, 4]] = np.nan
    np.testing.assert_array_equal(read_grid(path).heights, expected)


def test_an_alpha_band_asked_for_is_read_as_it_is(tmp_path):
    bands = np.stack([RAMP, RAMP]).astype(np.float32)
    meanings = [ColorInterp.gray, ColorInterp.alpha]
    path = write_raster(tmp_path / "a.tif", bands, colorinterp=meanings)
    np.testing.assert_array_equal(read_grid(path, band=2).heights, RAMP)


def test_a_mask_of_one_band_hides_samples(tmp_path):
    write_raster(tmp_path / "a.tif", np.stack([RAMP, RAMP != 7]).astype(np.uint8))
    path = write_vrt(
        tmp_path / "a.vrt",
        f"{vrt_source(1)}<MaskBand><VRTRasterBand dataType='Byte'>{vrt_source(2)}"
        "</VRTRasterBand></MaskBand>",
    )
    np.testing.assert_array_equal(read_grid(path).heights, np.where(RAMP == 7, np.nan, RAMP))


def test_a_fill_value_nobody_declared_is_kept_and_pointed_out(tmp_path):
    stored = RAMP.astype(np.float32)
    stored[0, :3], stored[3, 4], stored[2, 2] = -9999.0, 1e20, np.nan
    grid = read_grid(write_raster(tmp_path / "a.tif", stored))
    np.testing.assert_array_equal(grid.heights, stored)
    assert suspicious_values(grid) == [
        "-9999 in 3 samples: undeclared nodata?",
        "1e+20 in 1 samples: undeclared nodata?",
    ]


def test_fill_values_behind_fill_values_are_pointed_out():
    heights = RAMP.copy()
    heights[0, :4] = -3.4e38, -32768, -32767, 65535
    assert [line.split()[0] for line in suspicious_values(Grid(heights))] == [
        "-3.4e+38",
        "-32768",
        "-32767",
        "65535",
    ]


def test_of_many_extreme_heights_the_most_frequent_are_pointed_out():
    heights = np.random.default_rng(1).uniform(1e10, 1e30, (40, 50))
    heights[3] = -1e12
    heights[5:7, 5] = 2e12
    heights[-1] = 1.0
    lines = suspicious_values(Grid(heights))
    assert lines[0].startswith("-1e+12 in 50 samples")
    assert any(line.startswith("2e+12 in 2 samples") for line in lines)
    assert lines[-1] == "1,894 more such heights"
    assert len(lines) == 7


def test_a_usual_fill_value_among_heights_is_one_of_them():
    heights = [[-12000.0, -9999.0], [-9999.0, 5.0]]
    assert suspicious_values(Grid(heights)) == []


def test_nothing_but_fill_values_is_pointed_out():
    lines = suspicious_values(Grid([[-9999.0, -9999.0], [np.nan, 1e20]]))
    assert [line.split()[0] for line in lines] == ["-9999", "1e+20"]


def test_ordinary_heights_are_not_suspicious():
    assert suspicious_values(Grid([[-430.5, 0.0], [8848.0, np.nan]])) == []


@settings(deadline=None, derandomize=True, max_examples=40)
@given(data=st.data())
def test_any_mixture_of_voids_reads_as_its_union(tmp_path_factory, data):
    dtype = data.draw(st.sampled_from(["uint8", "int16", "uint16", "int32", "float32", "float64"]))
    shape = data.draw(hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=6))
    stored = data.draw(hnp.arrays(dtype, shape, elements=st.integers(0, 4)))
    nodata = data.draw(st.none() | st.integers(0, 5))
    shown = data.draw(st.none() | hnp.arrays(bool, shape))
    scale = data.draw(st.sampled_from([(1.0, 0.0), (0.25, 100.0)]))
    expected = stored * scale[0] + scale[1]
    expected[(stored == nodata) | (False if shown is None else ~shown)] = np.nan
    path = tmp_path_factory.mktemp("voids") / "a.tif"
    write_raster(path, stored, nodata=nodata, mask=shown, scale=scale)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_raster, "CHUNK_SAMPLES", 7)
        if np.isnan(expected).all():
            with pytest.raises(ValueError, match="hold no value"):
                read_grid(path)
        else:
            np.testing.assert_array_equal(read_grid(path).heights, expected)


# Place


@pytest.mark.parametrize("convention", ["Area", "Point"])
def test_a_sample_lies_at_the_centre_of_its_cell_in_both_conventions(tmp_path, convention):
    path = write_raster(
        tmp_path / "a.tif", RAMP.astype(np.int16), tags={"AREA_OR_POINT": convention}
    )
    grid = read_grid(path)
    assert grid.transform == Affine(10.0, 0.0, 1005.0, 0.0, -20.0, 8990.0)
    assert grid.crs.to_epsg() == 32628
    with rasterio.Env(GTIFF_POINT_GEO_IGNORE="YES"), rasterio.open(path) as file:
        stored_origin = file.transform[2], file.transform[5]
    assert stored_origin == ((1005.0, 8990.0) if convention == "Point" else (1000.0, 9000.0))


def test_corner_samples_of_an_hgt_tile_lie_on_whole_degrees(tmp_path):
    stored = np.full((1201, 1201), 300, ">i2")
    stored[0, 0], stored[5, 6] = 17, -32768
    path = tmp_path / "N45E006.hgt"
    path.write_bytes(stored.tobytes())
    grid = read_grid(path)
    a, _, x, _, e, y = grid.transform[:6]
    np.testing.assert_allclose([x, y, x + 1200 * a, y + 1200 * e], [6, 46, 7, 45], atol=1e-9)
    assert grid.heights[0, 0] == 17
    assert np.isnan(grid.heights[5, 6])
    assert grid.n_samples == grid.heights.size - 1


@pytest.mark.parametrize("transform", [PLACE, Affine(10.0, 2.0, 5.0, 3.0, -9.0, 7.0), None])
@pytest.mark.parametrize("window", [((1, 4), (2, 5)), Window(2, 1, 3, 3), Window(2.0, 1.0, 3, 3)])
def test_a_window_is_a_slice_in_its_place(tmp_path, transform, window):
    path = write_raster(tmp_path / "a.tif", RAMP.astype(np.float32), transform=transform)
    whole, part = read_grid(path), read_grid(path, window=window)
    np.testing.assert_array_equal(part.heights, RAMP[1:4, 2:5])
    a, b, x, d, e, y = whole.transform[:6]
    assert part.transform == Affine(a, b, x + 2 * a + b, d, e, y + 2 * d + e)


def test_voids_stay_where_they_are_in_a_window(tmp_path):
    shown = np.full(RAMP.shape, True)
    shown[2, 3] = False
    path = write_raster(tmp_path / "a.tif", RAMP.astype(np.int16), nodata=12, mask=shown)
    part = read_grid(path, window=((1, 4), (2, 5)))
    np.testing.assert_array_equal(np.argwhere(np.isnan(part.heights)), [[1, 0], [1, 1]])


def test_a_raster_without_georeference_gets_the_transform_of_a_grid(tmp_path):
    grid = read_grid(
        write_raster(tmp_path / "a.png", RAMP.astype(np.uint16), driver="PNG", transform=None)
    )
    assert grid.transform == Grid(RAMP).transform
    assert grid.crs is None


def test_ground_control_points_are_left_out_with_a_warning(tmp_path):
    points = [
        GroundControlPoint(row, col, col * 2.0, row * 3.0) for row in (0, 3) for col in (0, 4)
    ]
    path = write_raster(
        tmp_path / "a.tif", RAMP.astype(np.int16), transform=None, gcps=points, crs="EPSG:4326"
    )
    with pytest.warns(UserWarning, match="ground control points") as caught:
        grid = read_grid(path)
    assert grid.transform == Grid(RAMP).transform
    assert caught[0].filename == __file__


def test_a_crs_that_pyproj_does_not_know_is_left_out_with_a_warning(tmp_path, monkeypatch):
    def unknown(wkt):
        raise ValueError(f"crs must be one that pyproj knows, got {wkt!r}:\nno")

    path = write_raster(tmp_path / "a.tif", RAMP.astype(np.int16))
    monkeypatch.setattr(grids, "as_crs", unknown)
    with pytest.warns(UserWarning, match="CRS is left out") as caught:
        grid = read_grid(path)
    assert grid.crs is None
    assert grid.transform[2] == 1005.0
    assert len(caught) == 1
    assert "\n" not in str(caught[0].message)


# Colours

SCALE_AND_OFFSET = {"terrain-rgb": (0.1, -10000.0), "terrarium": (1 / 256, -32768.0)}
LAND = np.array([[-11000.0, -10000.5], [0.0, 0.25], [3776.1, 8848.9]])


@pytest.mark.parametrize("encoding", ["terrain-rgb", "terrarium"])
@pytest.mark.parametrize(("driver", "options"), [("PNG", {}), ("WEBP", {"LOSSLESS": "YES"})])
def test_tiles_of_coded_heights_are_recognised(tmp_path, encoding, driver, options):
    scale, offset = SCALE_AND_OFFSET[encoding]
    land = np.maximum(LAND, offset)
    path = tmp_path / "tile.png"
    write_raster(path, encode(land, scale, offset), driver=driver, transform=None, **options)
    for asked in (None, encoding):
        heights = read_grid(path, encoding=asked).heights
        assert heights.dtype == np.float32
        np.testing.assert_allclose(heights, land, atol=scale / 2 + 1e-3, rtol=0)


def test_transparent_pixels_are_void_and_need_not_be_plausible(tmp_path):
    colours = np.concatenate([encode(LAND, 1 / 256, -32768.0), np.full((1, 3, 2), 255, np.uint8)])
    colours[:, 1, 0] = 255, 255, 255, 0
    path = write_raster(tmp_path / "a.png", colours, driver="PNG", transform=None)
    heights = read_grid(path, window=((1, 3), (0, 2))).heights
    np.testing.assert_array_equal(np.isnan(heights), [[True, False], [False, False]])
    np.testing.assert_allclose(heights[1], LAND[2], atol=1 / 256)


def test_a_colour_that_is_nodata_in_every_band_is_void(tmp_path):
    colours = encode(LAND, 1 / 256, -32768.0)
    colours[:, 1, 0] = 0
    colours[0, 2, 0] = 128
    grid = read_grid(write_raster(tmp_path / "a.tif", colours, nodata=0))
    np.testing.assert_array_equal(np.argwhere(np.isnan(grid.heights)), [[1, 0]])


def test_a_tile_with_a_palette_is_read_by_its_colours(tmp_path):
    colours = {0: (1, 134, 160, 255), 1: (1, 134, 170, 255), 2: (9, 9, 9, 0)}
    indices = np.array([[0, 1, 2], [2, 1, 1]], np.uint8)  # also the heights
    path = write_raster(tmp_path / "a.png", indices, driver="PNG", colormap=colours)
    expected = np.array([[0, 1, np.nan], [np.nan, 1, 1]])
    np.testing.assert_array_equal(read_grid(path).heights, expected)
    colours[0] = colours[2]
    mostly_void = write_raster(tmp_path / "c.png", indices, driver="PNG", colormap=colours)
    assert read_grid(mostly_void).n_samples == 3
    colours[0], colours[2] = (1, 134, 160, 255), (1, 134, 180, 255)
    opaque = write_raster(tmp_path / "a.tif", indices, colormap=colours)
    np.testing.assert_array_equal(read_grid(opaque).heights, indices)
    np.testing.assert_array_equal(read_grid(opaque, encoding="none").heights, indices)
    entries = "".join(
        "<Entry c1='{}' c2='{}' c3='{}' c4='{}'/>".format(*c) for c in colours.values()
    )
    declared = write_vrt(
        tmp_path / "a.vrt",
        f"<NoDataValue>2</NoDataValue><ColorInterp>Palette</ColorInterp>"
        f"<ColorTable>{entries}</ColorTable>{vrt_source(1, rows=2, cols=3)}",
        2,
        3,
    )
    np.testing.assert_array_equal(read_grid(declared).heights, expected)


@pytest.mark.parametrize("n_bands", [3, 4])
def test_a_picture_is_not_taken_for_heights(tmp_path, n_bands):
    picture = np.random.default_rng(0).integers(0, 255, (n_bands, 8, 8)).astype(np.uint8)
    path = write_raster(tmp_path / "a.png", picture, driver="PNG", transform=None)
    with pytest.raises(ValueError, match="give the encoding") as error:
        read_grid(path)
    assert one_line(error)
    picture[2][picture[-1] == 0] = 0 if n_bands == 3 else picture[2][picture[-1] == 0]
    plain = read_grid(path, band=3, encoding="none").heights
    np.testing.assert_array_equal(plain[~np.isnan(plain)], picture[2][~np.isnan(plain)])


def test_a_band_number_does_not_go_with_colours(tmp_path):
    path = write_raster(tmp_path / "a.tif", encode(LAND, 0.1, -10000.0).clip(0, 255))
    with pytest.raises(ValueError, match="encoding 'none'"):
        read_grid(path, band=2)


def test_an_encoding_needs_colours(tmp_path):
    path = write_raster(tmp_path / "a.tif", RAMP.astype(np.int16))
    with pytest.raises(ValueError, match="got 1 of int16; leave the encoding out"):
        read_grid(path, encoding="terrarium")
    with pytest.raises(ValueError, match="encoding must be"):
        read_grid(path, encoding="terrainrgb")


# Other formats


@pytest.mark.parametrize(
    ("driver", "name", "dtype"),
    [
        ("COG", "a.tif", "float32"),
        ("AAIGrid", "a.asc", "int16"),
        ("GSBG", "a.grd", "float32"),
        ("JP2OpenJPEG", "a.jp2", "int16"),
        ("PNG", "a.png", "uint8"),
        ("PNG", "a.png", "uint16"),
    ],
)
def test_reads_other_formats_and_refuses_their_truncated_files(
    tmp_path, capfd, driver, name, dtype
):
    heights = np.random.default_rng(1).integers(0, 900, (64, 48)).astype(dtype)
    lossless = {"REVERSIBLE": "YES", "QUALITY": "100"} if driver == "JP2OpenJPEG" else {}
    square = Affine(10.0, 0.0, 1000.0, 0.0, -10.0, 9000.0)
    path = write_raster(tmp_path / name, heights, driver=driver, transform=square, **lossless)
    np.testing.assert_array_equal(read_grid(path).heights, heights)
    whole = path.read_bytes()
    for kept in (0.95, 0.5, 0.05):
        path.write_bytes(whole[: int(len(whole) * kept)])
        with pytest.raises(OSError, match="cannot be read as a raster") as error:
            read_grid(path)
        assert one_line(error)
    assert capfd.readouterr() == ("", "")


def test_damage_found_by_another_thread_stays_off_stderr(tmp_path, capfd):
    heights = np.random.default_rng(1).integers(0, 900, (192, 128)).astype(np.int16)
    tiled = {"BLOCKXSIZE": 64, "BLOCKYSIZE": 64}
    path = write_raster(tmp_path / "a.jp2", heights, driver="JP2OpenJPEG", **tiled)
    start_of_tile = b"\xff\x90\x00\x0a"
    first, second, third, *others = path.read_bytes().split(start_of_tile)
    path.write_bytes(start_of_tile.join([first, second, third + bytes(4), *others]))
    with pytest.raises(OSError, match="cannot be read as a raster"):
        read_grid(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("driver", "name"), [("ENVI", "a.dat"), ("EHdr", "a.bil"), ("ISCE", "a.isce")]
)
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_a_short_raw_file_is_refused_not_filled_with_zeros(tmp_path, driver, name, dtype):
    path = write_raster(tmp_path / name, RAMP.astype(dtype), driver=driver)
    np.testing.assert_array_equal(read_grid(path).heights, RAMP)
    whole = path.read_bytes()
    for length in (len(whole) - 1, len(whole) * 3 // 5, len(whole) // 4):
        path.write_bytes(whole[:length])
        with pytest.raises(OSError, match="too small") as error:
            read_grid(path)
        assert one_line(error)


def test_a_raw_file_of_packed_bits_is_not_too_small(tmp_path):
    path = write_raster(tmp_path / "a.bil", (RAMP % 2).astype(np.uint8), driver="EHdr", nbits=1)
    np.testing.assert_array_equal(read_grid(path).heights, RAMP % 2)


@pytest.mark.parametrize("interleave", ["BSQ", "BIL"])
def test_the_header_of_an_envi_file_counts_in_its_size(tmp_path, interleave):
    bands = np.stack([RAMP, RAMP + 1]).astype(np.float32)
    path = write_raster(tmp_path / "a.dat", bands, driver="ENVI", INTERLEAVE=interleave)
    header, whole = tmp_path / "a.hdr", path.read_bytes()
    header.write_text(header.read_text().replace("header offset = 0", "header offset = 8"))
    (tmp_path / "a.dat.aux.xml").unlink()  # repeats the header as it was
    path.write_bytes(bytes(8) + whole)
    np.testing.assert_array_equal(read_grid(path, band=2).heights, RAMP + 1)
    for length in (len(whole) + 7, len(whole) // 2 + 8, 20):
        path.write_bytes((bytes(8) + whole)[:length])
        with pytest.raises(OSError, match="too small") as error:
            read_grid(path)
        assert one_line(error)


def test_reads_a_usgs_dem(tmp_path):
    heights = np.arange(12, dtype=np.int16).reshape(4, 3)
    square = Affine(10.0, 0.0, 1000.0, 0.0, -10.0, 9000.0)
    grid = read_grid(write_raster(tmp_path / "a.dem", heights, driver="USGSDEM", transform=square))
    lo, hi = np.nanmin(grid.heights), np.nanmax(grid.heights)
    assert (lo, hi) == (0, 11)


def test_reads_a_vrt_over_another_file(tmp_path):
    write_raster(tmp_path / "a.tif", RAMP.astype(np.int16))
    vrt = write_vrt(tmp_path / "a.vrt", vrt_source(1, 1, 1, 3, 4), 3, 4)
    np.testing.assert_array_equal(read_grid(vrt).heights, RAMP[1:, 1:])
    (tmp_path / "a.tif").unlink()
    with pytest.raises(OSError, match=r"a\.vrt cannot be read"):
        read_grid(vrt)


def write_netcdf(path, *names):
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(path, "w") as file:
        for dim, size in zip(("lat", "lon"), RAMP.shape, strict=True):
            file.createDimension(dim, size)
            axis = file.createVariable(dim, "f8", (dim,))
            axis.units = {"lat": "degrees_north", "lon": "degrees_east"}[dim]
            axis[:] = 10.0 + 0.5 * np.arange(size)
        for name in names:
            variable = file.createVariable(name, "i2", ("lat", "lon"), fill_value=-1)
            variable.set_auto_scale(False)
            variable.scale_factor, variable.add_offset = 0.5, 100.0
            variable[:] = np.where(RAMP == 3, -1, RAMP)
    return path


def test_netcdf_reads_north_up_with_scale_offset_and_fill(tmp_path):
    grid = read_grid(write_netcdf(tmp_path / "a.nc", "height"))
    expected = np.where(RAMP == 3, np.nan, RAMP * 0.5 + 100.0)[::-1]
    np.testing.assert_array_equal(grid.heights, expected)
    np.testing.assert_allclose(grid.transform[:6], (0.5, 0.0, 10.0, 0.0, -0.5, 11.5))


def test_a_file_of_several_rasters_names_them(tmp_path):
    path = write_netcdf(tmp_path / "a.nc", "height", "depth")
    with pytest.raises(ValueError, match="holds several rasters; pass the name of one") as error:
        read_grid(path)
    assert one_line(error)
    name = next(word for word in str(error.value).split() if word.endswith("depth"))
    assert read_grid(name).shape == RAMP.shape


@pytest.mark.parametrize("dtype", [">f4", "<f4", "<i2", "float64", "int64"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_reads_whole_and_by_window(tmp_path, dtype, order):
    path = tmp_path / "a.npy"
    np.save(path, np.array(RAMP, dtype, order=order))
    whole, part = read_grid(path), read_grid(path, window=((1, 3), (2, 4)))
    assert whole.heights.dtype == np.float32
    np.testing.assert_array_equal(whole.heights, RAMP)
    np.testing.assert_array_equal(part.heights, RAMP[1:3, 2:4])
    assert whole.transform == Grid(RAMP).transform
    assert part.transform == Affine(1.0, 0.0, 2.0, 0.0, -1.0, -1.0)


def test_a_grid_does_not_change_with_its_npy_file(tmp_path):
    np.save(tmp_path / "a.npy", RAMP.astype(np.float32))
    grid = read_grid(tmp_path / "a.npy")
    np.lib.format.open_memmap(tmp_path / "a.npy", mode="r+")[:] = 0
    np.testing.assert_array_equal(grid.heights, RAMP)


# Bad input


def test_a_missing_file_is_named_in_one_line(tmp_path):
    for name in ("none.tif", "none.npy", "none.hgt"):
        with pytest.raises(FileNotFoundError, match=rf"{name}: no such file") as error:
            read_grid(tmp_path / name)
        assert one_line(error)


def test_a_directory_is_not_a_raster(tmp_path):
    for name in ("folder", "folder.npy"):
        (tmp_path / name).mkdir()
        with pytest.raises(IsADirectoryError, match="is a directory"):
            read_grid(tmp_path / name)


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.asc", "a.hgt", "a.npy", "a.nc"])
@pytest.mark.parametrize("content", [b"", b"hello, I am a text\n" * 9, b"\x93NUMPY", b"II*\0"])
def test_another_kind_of_file_is_unreadable(tmp_path, capfd, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(OSError, match="cannot be read as a raster") as error:
        read_grid(path)
    assert one_line(error)
    assert str(path) in str(error.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text elsewhere")
def test_a_name_that_is_not_text_is_unreadable(tmp_path):
    path = bytes(tmp_path) + b"/\xff.tif"
    write_raster(tmp_path / "a.tif", RAMP.astype(np.float32)).rename(os.fsdecode(path))
    with pytest.raises(OSError, match="cannot be read as a raster"):
        read_grid(path)


@pytest.mark.parametrize(
    "failure", [CPLE_BaseError(3, 1, "no"), CRSError("no"), RasterioError("no")]
)
def test_every_family_of_rasterio_failures_is_one_os_error(tmp_path, monkeypatch, failure):
    def fail(*args):
        raise failure

    path = write_raster(tmp_path / "a.tif", RAMP.astype(np.float32))
    monkeypatch.setattr(rasterio, "open", fail)
    with pytest.raises(OSError, match=r"a\.tif cannot be read .* no$"):
        read_grid(path)


@pytest.mark.parametrize("band", [0, 3, -1])
def test_a_band_that_does_not_exist_says_how_many_there_are(tmp_path, band):
    path = write_raster(tmp_path / "a.tif", np.stack([RAMP, RAMP]).astype(np.float32))
    with pytest.raises(ValueError, match="band must be from 1 to 2, got"):
        read_grid(path, band=band)


@pytest.mark.parametrize("suffix", ["tif", "npy"])
@pytest.mark.parametrize(
    "window", [((0, 5), (0, 5)), ((-1, 2), (0, 2)), ((2, 2), (0, 5)), Window(3, 0, 3, 2)]
)
def test_a_window_outside_the_raster_says_its_size(tmp_path, suffix, window):
    path = tmp_path / f"a.{suffix}"
    np.save(path, RAMP) if suffix == "npy" else write_raster(path, RAMP.astype(np.float32))
    with pytest.raises(ValueError, match="inside the raster of 4 rows and 5 columns"):
        read_grid(path, window=window)


@pytest.mark.parametrize(
    "window",
    [
        (0, 2, 0, 2),
        ((0, 2),),
        "all",
        ((0, None), (0, 2)),
        Window(0.5, 0, 2, 2),
        ((0, float("inf")), (0, 2)),
        7,
    ],
)
def test_a_window_of_another_form_is_refused(tmp_path, window):
    path = write_raster(tmp_path / "a.tif", RAMP.astype(np.float32))
    with pytest.raises(ValueError, match="window must be a rasterio Window or") as error:
        read_grid(path, window=window)
    assert one_line(error)


@pytest.mark.parametrize(
    ("heights", "error", "message"),
    [
        (np.ones((1, 5), np.float32), ValueError, "at least 2 rows and 2 columns"),
        (np.full((3, 3), np.nan, np.float32), ValueError, "hold no value at all"),
        (np.array([[0, 1], [np.inf, 0]], np.float32), ValueError, "got inf at row 1"),
        (np.ones((3, 3), np.complex64), TypeError, "real numbers, band 1 holds complex64"),
    ],
)
def test_heights_that_are_none_name_the_file(tmp_path, heights, error, message):
    with pytest.raises(error, match=rf"a\.tif: .*{message}") as caught:
        read_grid(write_raster(tmp_path / "a.tif", heights))
    assert one_line(caught)


@pytest.mark.parametrize(
    ("array", "error", "message"),
    [
        (np.ones((2, 2, 2)), ValueError, "two dimensions"),
        (np.ones((2, 2), complex), TypeError, "real numbers"),
        (np.array([["a", "b"], ["c", "d"]]), TypeError, "real numbers"),
        (np.array([[None, 1], [2, 3]], object), OSError, "cannot be read"),
    ],
)
def test_an_npy_without_heights_names_the_file(tmp_path, array, error, message):
    path = tmp_path / "a.npy"
    np.save(path, array, allow_pickle=True)
    with pytest.raises(error, match=rf"a\.npy.*{message}") as caught:
        read_grid(path)
    assert one_line(caught)


def test_an_npy_has_one_band_and_no_colours(tmp_path):
    np.save(tmp_path / "a.npy", RAMP)
    for options in ({"band": 2}, {"encoding": "terrarium"}):
        with pytest.raises(ValueError, match="one band of plain heights"):
            read_grid(tmp_path / "a.npy", **options)


def test_a_truncated_npy_is_unreadable(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, RAMP)
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(OSError, match="cannot be read"):
        read_grid(path)


def test_a_raster_larger_than_memory_asks_for_a_window(tmp_path):
    side = 1 << 24
    vrt = write_vrt(tmp_path / "a.vrt", "", side, side)
    with pytest.raises(MemoryError, match=r"need \d+\.\d GB .* with window=") as error:
        read_grid(vrt)
    assert one_line(error)
    assert read_grid(vrt, window=((0, 3), (0, 4))).shape == (3, 4)


@pytest.mark.parametrize("suffix", ["tif", "npy", "png"])
def test_every_kind_of_raster_is_measured_against_the_memory(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"a.{suffix}"
    if suffix == "npy":
        np.save(path, RAMP)
    else:
        write_raster(path, encode(RAMP, 0.1, -10000.0) if suffix == "png" else RAMP)
    monkeypatch.setattr(grids, "available_memory", lambda: 10)
    with pytest.raises(MemoryError, match="need"):
        read_grid(path)
    monkeypatch.setattr(grids, "available_memory", lambda: None)
    assert read_grid(path).n_samples


def testavailable_memory_is_a_number_of_bytes_or_unknown():
    available = grids.available_memory()
    assert available is None or available > 1 << 20


def test_importing_the_reader_does_not_import_rasterio():
    code = "import sys, rtin.io.grids; sys.exit('rasterio' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# Fuzz. rasterio reports, by way of Python's unraisable hook, GDAL messages that are not UTF-8.

fuzz = settings(
    deadline=None,
    derandomize=True,
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
quiet = pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::UserWarning"
)


def read_or_refuse(path: Path) -> bool:
    """Return True for a grid, False for an error in one line; let everything else through."""
    try:
        return isinstance(read_grid(path), Grid)
    except (OSError, ValueError, TypeError, MemoryError) as error:
        message = str(error)
    assert len(message.splitlines()) == 1
    assert path.name in message
    return False


@quiet
@fuzz
@given(content=st.binary(max_size=300), suffix=st.sampled_from(["tif", "png", "npy", "asc", "hgt"]))
def test_any_bytes_are_a_grid_or_one_line(tmp_path, content, suffix):
    path = tmp_path / f"N45E006.{suffix}"
    path.write_bytes(content)
    read_or_refuse(path)


@pytest.fixture(scope="module")
def good_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    heights = np.random.default_rng(2).integers(0, 900, (9, 9)).astype(np.int16)
    np.save(folder / "a.npy", heights)
    write_raster(folder / "a.tif", heights, nodata=3, compress="deflate")
    write_raster(folder / "a.png", heights.astype(np.uint16), driver="PNG", transform=None)
    square = Affine(10.0, 0.0, 1000.0, 0.0, -10.0, 9000.0)
    write_raster(folder / "a.asc", heights, driver="AAIGrid", transform=square)
    write_raster(folder / "tile.png", encode(heights, 0.1, -10000.0), driver="PNG", transform=None)
    palette = {index: (1, 134, index, 255) for index in range(256)}
    indices = (heights % 256).astype(np.uint8)
    write_raster(folder / "palette.png", indices, driver="PNG", transform=None, colormap=palette)
    return {path.name: path.read_bytes() for path in folder.glob("*.???")}


@quiet
@fuzz
@given(data=st.data())
def test_a_damaged_file_is_a_grid_or_one_line(tmp_path, good_files, data):
    name = data.draw(st.sampled_from(["a.npy", "a.tif", "a.png", "tile.png", "a.asc"]))
    content = bytearray(good_files[name])
    for _ in range(data.draw(st.integers(0, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / name
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    read_or_refuse(path)


@quiet
@pytest.mark.parametrize("name", ["a.npy", "a.tif", "a.png", "tile.png", "palette.png"])
def test_no_truncated_file_is_a_grid(tmp_path, good_files, name):
    path, content = tmp_path / name, good_files[name]
    path.write_bytes(content)
    assert read_or_refuse(path)
    # A PNG holds its heights without the 12 bytes that end it.
    for length in range(0, len(content) - 12, 7):
        path.write_bytes(content[:length])
        assert not read_or_refuse(path)


# Every second, third, … row and column


WAVES = np.round(
    1000.0 + 900.0 * np.sin(np.arange(70.0)[:, None] / 5) * np.cos(np.arange(90.0) / 7)
)
LAYOUTS = {
    "tiles": {"tiled": True, "blockxsize": 16, "blockysize": 32},
    "strips": {"blockysize": 8},
    "rows": {"blockysize": 1},
    "compressed": {"tiled": True, "blockxsize": 32, "blockysize": 16, "compress": "deflate"},
}


def sliced(grid, step):
    a, b, x, d, e, y = grid.transform[:6]
    place = Affine(a * step, b * step, x, d * step, e * step, y)
    return grid.heights[::step, ::step], place


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("step", [1, 2, 3, 16, 17, 31, 40])
@pytest.mark.parametrize("window", [None, ((3, 68), (5, 90)), ((33, 69), (47, 88))])
def test_a_step_reads_what_a_slice_of_the_whole_holds(tmp_path, layout, step, window):
    if step == 40 and window is not None:
        window = ((3, 60), (5, 90))
    stored = WAVES.astype(np.int16)
    path = write_raster(
        tmp_path / "a.tif", stored, nodata=int(stored[0, 2]), transform=Affine.rotation(33),
        mask=WAVES < 1800, **LAYOUTS[layout],
    )  # fmt: skip
    heights, place = sliced(read_grid(path, window=window), step)
    grid = read_grid(path, window=window, step=step)
    np.testing.assert_array_equal(grid.heights, heights)
    assert grid.transform.almost_equals(place, 1e-12)
    assert grid.crs.to_epsg() == 32628


def test_a_step_reads_samples_where_the_file_has_overviews(tmp_path):
    path = write_raster(tmp_path / "a.tif", WAVES.astype(np.float32))
    with rasterio.open(path, "r+") as file:
        file.build_overviews([2, 4], Resampling.average)
    np.testing.assert_array_equal(read_grid(path, step=4).heights, WAVES[::4, ::4])


def test_few_samples_are_read_at_a_time(tmp_path, monkeypatch):
    monkeypatch.setattr(_thinning, "_MOST_AT_ONCE", 300)
    path = write_raster(tmp_path / "a.tif", WAVES.astype(np.float32), **LAYOUTS["tiles"])
    np.testing.assert_array_equal(read_grid(path, step=3).heights, WAVES[::3, ::3])


def test_blocks_between_two_samples_are_passed_over(tmp_path, monkeypatch):
    path = write_raster(tmp_path / "a.tif", WAVES.astype(np.float32), **LAYOUTS["rows"])
    seen = []
    monkeypatch.setattr(
        _thinning, "_taken", lambda span, wanted: seen.append(span) or taken(span, wanted)
    )
    taken = _taken
    read_grid(path, step=20)
    assert [span for span in seen if span != (0, 90)] == [(0, 1), (20, 21), (40, 41), (60, 61)]


@pytest.mark.parametrize("encoding", ["terrain-rgb", "terrarium"])
def test_colours_are_thinned_before_they_are_heights(tmp_path, encoding):
    scale, offset = {"terrain-rgb": (0.1, -10000.0), "terrarium": (1 / 256, -32768.0)}[encoding]
    path = write_raster(tmp_path / "a.png", encode(WAVES, scale, offset), driver="PNG")
    heights, _ = sliced(read_grid(path), 4)
    np.testing.assert_array_equal(read_grid(path, step=4).heights, heights)
    np.testing.assert_allclose(heights, WAVES[::4, ::4], atol=0.1)


def test_alpha_scale_and_wide_integers_are_thinned_alike(tmp_path):
    bands = np.stack([WAVES, WAVES < 1500]).astype(np.int32)
    meanings = [ColorInterp.gray, ColorInterp.alpha]
    path = write_raster(tmp_path / "a.tif", bands, colorinterp=meanings, scale=(0.5, 7.0))
    heights, _ = sliced(read_grid(path), 5)
    assert np.isnan(heights).any()
    np.testing.assert_array_equal(read_grid(path, step=5).heights, heights)


@pytest.mark.parametrize("window", [None, ((3, 68), (5, 90))])
def test_an_array_is_thinned_without_reading_all_of_it(tmp_path, window):
    np.save(tmp_path / "a.npy", WAVES)
    heights, place = sliced(read_grid(tmp_path / "a.npy", window=window), 7)
    grid = read_grid(tmp_path / "a.npy", window=window, step=7)
    np.testing.assert_array_equal(grid.heights, heights)
    assert grid.transform == place


@pytest.mark.parametrize("name", ["a.tif", "a.npy"])
@pytest.mark.parametrize(
    ("step", "kind", "said"),
    [
        (0, ValueError, "step must be a whole number from 1, got 0"),
        (-3, ValueError, "step must be a whole number from 1, got -3"),
        (2.0, TypeError, "step must be a whole number from 1, got 2.0"),
        (True, TypeError, "step must be a whole number from 1, got True"),
        (90, ValueError, "heights must have at least 2 rows and 2 columns"),
    ],
)
def test_an_impossible_step_is_refused(tmp_path, name, step, kind, said):
    np.save(tmp_path / "a.npy", WAVES)
    write_raster(tmp_path / "a.tif", WAVES.astype(np.float32))
    with pytest.raises(kind, match=said) as error:
        read_grid(tmp_path / name, step=step)
    assert one_line(error)


def test_a_thinned_file_that_is_cut_off_is_refused(tmp_path):
    path = write_raster(tmp_path / "a.tif", WAVES.astype(np.float32), **LAYOUTS["compressed"])
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.raises(OSError, match=r"a\.tif cannot be read") as error:
        read_grid(path, step=8)
    assert one_line(error)
