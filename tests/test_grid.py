"""The grid's door: what it takes, what it keeps, and what it says of everything else."""

import dataclasses

import numpy as np
import pytest
from affine import Affine

import rtin

KEPT_AS = {
    "i1": "float32", "u1": "float32", "i2": "float32", "u2": "float32", "f2": "float32",
    "f4": "float32", ">f4": "float32", ">i2": "float32", "i4": "float32", "f8": "float32",
}  # fmt: skip


@pytest.mark.parametrize("dtype", KEPT_AS)
def test_keeps_heights_as_float32_where_nothing_is_lost(dtype):
    heights = np.array([[1, 2, 3], [40, 50, 60]], dtype)
    grid = rtin.Grid(heights)
    assert grid.heights.dtype == KEPT_AS[dtype]
    np.testing.assert_array_equal(grid.heights, [[1, 2, 3], [40, 50, 60]])


@pytest.mark.parametrize("value", [0.1, 1e8 + 1, 2**24 + 1, 1e100, 2**53])
def test_keeps_heights_as_float64_where_float32_would_lose(value):
    grid = rtin.Grid([[0, 1], [2, value]])
    exact_in_float32 = float(np.float32(min(value, 1e38))) == value
    assert grid.heights.dtype == (np.float32 if exact_in_float32 else np.float64)
    assert grid.heights[1, 1] == value


def test_finds_the_one_height_that_float32_cannot_hold():
    heights = np.zeros((700, 500))
    heights[699, 499] = 0.1
    assert rtin.Grid(heights).heights.dtype == np.float64


def test_takes_nested_lists():
    assert rtin.Grid([[1, 2], [3, 4]]).shape == (2, 2)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_does_not_copy_what_it_can_use(dtype):
    heights = np.full((3, 4), 0.1, dtype)
    assert np.shares_memory(rtin.Grid(heights).heights, heights)
    assert heights.flags.writeable


def test_heights_cannot_be_written_to():
    grid = rtin.Grid(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="read-only"):
        grid.heights[0, 0] = 1.0
    with pytest.raises(AttributeError):
        grid.heights = np.zeros((3, 4))


def test_brings_heights_into_c_order():
    heights = np.asfortranarray(np.arange(12.0).reshape(3, 4))
    grid = rtin.Grid(heights)
    assert grid.heights.flags.c_contiguous
    np.testing.assert_array_equal(grid.heights, heights)


def test_counts_the_samples_that_have_a_height():
    heights = np.arange(12.0).reshape(3, 4)
    assert (rtin.Grid(heights).n_samples, rtin.Grid(heights).has_voids) == (12, False)
    heights[1, 2] = heights[0, 0] = np.nan
    assert (rtin.Grid(heights).n_samples, rtin.Grid(heights).has_voids) == (10, True)


@pytest.mark.parametrize("dtype", [np.int16, np.float32, np.float64])
def test_masked_samples_are_void(dtype):
    heights = np.ma.masked_equal(np.array([[1, -9999], [3, 4]], dtype), -9999)
    grid = rtin.Grid(heights)
    np.testing.assert_array_equal(grid.heights, [[1, np.nan], [3, 4]])
    assert grid.has_voids


def test_a_mask_hides_what_would_be_refused():
    heights = np.ma.masked_invalid([[1.0, np.inf], [3.0, 4.0]])
    np.testing.assert_array_equal(rtin.Grid(heights).heights, [[1, np.nan], [3, 4]])


@pytest.mark.parametrize(
    ("dtype", "hidden"), [(np.int64, 2**63 - 1), (np.uint64, 2**64 - 1), (np.float64, 1e20)]
)
def test_masked_samples_do_not_decide_how_the_others_are_kept(dtype, hidden):
    heights = np.ma.masked_equal(np.array([[1, hidden], [3, 4]], dtype), dtype(hidden))
    grid = rtin.Grid(heights)
    assert grid.heights.dtype == np.float32
    np.testing.assert_array_equal(grid.heights, [[1, np.nan], [3, 4]])
    assert heights.data[0, 1] == dtype(hidden)


def test_an_empty_mask_makes_no_void():
    assert not rtin.Grid(np.ma.masked_equal(np.ones((2, 2)), 7)).has_voids


def test_row_0_is_north_unless_told_otherwise():
    assert rtin.Grid(np.zeros((2, 2))).transform == Affine(1, 0, 0, 0, -1, 0)


@pytest.mark.parametrize("kind", [tuple, list, np.array, lambda six: Affine(*six)])
def test_takes_six_numbers_as_a_transform(kind):
    six = 2, 0, 5, 0, -3, 7
    assert rtin.Grid(np.zeros((2, 2)), kind(six)).transform == Affine(*six)


@pytest.mark.parametrize("crs", ["EPSG:2056", 2056])
def test_takes_what_pyproj_takes_as_a_crs(crs):
    assert rtin.Grid(np.zeros((2, 2)), crs=crs).crs.to_epsg() == 2056


def test_replace_gives_a_changed_and_checked_grid():
    grid = rtin.Grid([[1, 2], [3, np.nan]], (2, 0, 5, 0, -3, 7), 4326)
    placed = dataclasses.replace(grid, crs=2056)
    assert (placed.crs.to_epsg(), placed.transform) == (2056, grid.transform)
    assert placed.heights is not grid.heights
    assert np.shares_memory(placed.heights, grid.heights)
    assert not dataclasses.replace(grid, heights=np.zeros((2, 2))).has_voids
    with pytest.raises(ValueError, match="no value at all"):
        dataclasses.replace(grid, heights=np.full((2, 2), np.nan))


def test_shows_what_matters():
    assert repr(rtin.Grid([[1, 2], [3, np.nan]])) == "<Grid 2 × 2 float32, with voids, no CRS>"
    assert repr(rtin.Grid([[1, 2], [3, 4]], crs=4326)) == "<Grid 2 × 2 float32, EPSG:4326>"


FLAT = np.zeros((2, 2))
WRONG = {
    "one row": (
        {"heights": np.zeros((1, 9))},
        ValueError,
        r"2 rows and 2 columns, got .* \(1, 9\)",
    ),
    "one column": ({"heights": np.zeros((9, 1))}, ValueError, r"got an array of shape \(9, 1\)"),
    "empty": ({"heights": np.zeros((0, 0))}, ValueError, r"got an array of shape \(0, 0\)"),
    "one dimension": ({"heights": np.zeros(9)}, ValueError, r"got an array of shape \(9,\)"),
    "three dimensions": ({"heights": np.zeros((1, 9, 9))}, ValueError, r"shape \(1, 9, 9\)"),
    "a number": ({"heights": 5.0}, ValueError, r"shape \(\)"),
    "strings": ({"heights": [["a", "b"], ["c", "d"]]}, TypeError, "real numbers, got .* <U1"),
    "complex": ({"heights": FLAT + 1j}, TypeError, "real numbers, got .* complex128"),
    "booleans": ({"heights": FLAT > 1}, TypeError, "real numbers, got .* bool"),
    "objects": ({"heights": [[None, 1], [2, 3]]}, TypeError, "real numbers, got .* object"),
    "dates": ({"heights": FLAT.astype("M8[s]")}, TypeError, "real numbers, got .* datetime"),
    "infinite": ({"heights": [[0, 1], [np.inf, 2]]}, ValueError, "got inf at row 1, column 0"),
    "minus infinite": ({"heights": [[-np.inf, 1], [0, 2]]}, ValueError, "row 0, column 0"),
    "overflowing": (
        {"heights": [[0, 1], [2, -1.7e308]]},
        ValueError,
        r"at most 1e\+100 in magnitude, got -1\.7e\+308 at row 1, column 1",
    ),
    "just too large": ({"heights": [[0, np.nan], [2, 1.01e100]]}, ValueError, r"got 1\.01e\+100"),
    "all NaN": ({"heights": FLAT * np.nan}, ValueError, "no value at all"),
    "all masked": ({"heights": np.ma.masked_all((3, 3))}, ValueError, "no value at all"),
    "too large": ({"heights": [[0, 1], [2, 2**63 - 1]]}, ValueError, "do not fit float64"),
    "short transform": ({"heights": FLAT, "transform": (1, 2, 3)}, ValueError, "six numbers"),
    "text transform": ({"heights": FLAT, "transform": "north"}, ValueError, "six .* got 'north'"),
    "no transform": ({"heights": FLAT, "transform": None}, ValueError, "six numbers .* got None"),
    "flat transform": (
        {"heights": FLAT, "transform": (1, 1, 0, 1, 1, 0)},
        ValueError,
        r"a\*e != b",
    ),
    "NaN transform": (
        {"heights": FLAT, "transform": (1, 0, np.nan, 0, 1, 0)},
        ValueError,
        "finite",
    ),
    "unknown crs": ({"heights": FLAT, "crs": "EPSG:0"}, ValueError, "crs must be .* got 'EPSG:0'"),
    "crs kind": (
        {"heights": FLAT, "crs": object()},
        ValueError,
        "crs must be one that",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_says_in_one_line_what_was_wanted_and_what_came(wrong):
    options, error, message = WRONG[wrong]
    with pytest.raises(error, match=message) as raised:
        rtin.Grid(**options)
    assert "\n" not in str(raised.value)


def test_names_the_row_of_an_infinite_height_in_a_large_raster():
    heights = np.zeros((900, 500), np.float32)
    heights[765, 4] = np.inf
    with pytest.raises(ValueError, match="row 765, column 4"):
        rtin.Grid(heights)
