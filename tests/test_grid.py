"""The grid's door: what it takes, what it keeps, and what it says of everything else."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import meshes
import rtin
import terrains

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


# --- places and heights of points ---------------------------------------------------------------


def world(transform, places):
    """(x, y) of places (row, col)."""
    return np.array([transform @ (col, row) for row, col in places])


def bilinear(heights, row, col):
    """Height at a place by the four samples around it; NaN where one that has a share lacks it."""
    total = 0.0
    for i in range(heights.shape[0]):
        for j in range(heights.shape[1]):
            share = max(0.0, 1.0 - abs(i - row)) * max(0.0, 1.0 - abs(j - col))
            if share > 0.0:
                total += share * heights[i, j]
    return total


@pytest.mark.parametrize("transform", meshes.TRANSFORMS)
@pytest.mark.parametrize("shape", [(2, 2), (2, 7), (5, 4), (1000, 3)], ids=str)
def test_places_of_samples_are_whole_and_heights_exact(transform, shape):
    transform = meshes.TRANSFORMS[transform]
    heights = np.random.default_rng(0).random(shape)  # which float32 would not hold
    grid = rtin.Grid(heights, transform)
    places = list(np.ndindex(shape))
    np.testing.assert_array_equal(grid.places(world(transform, places)), places)
    at = grid.heights_at(world(transform, places))
    assert at.dtype == np.float64
    np.testing.assert_array_equal(at.reshape(shape), heights)


@given(
    terrains.rasters(largest=6),
    st.sampled_from(list(meshes.TRANSFORMS)),
    st.lists(st.tuples(st.floats(-1, 6), st.floats(-1, 6)), min_size=1, max_size=30),
)
def test_heights_between_samples_are_bilinear_and_nan_outside(heights, transform, places):
    transform = meshes.TRANSFORMS[transform]
    grid = rtin.Grid(heights, transform)
    points = world(transform, places)
    rows, cols = np.subtract(heights.shape, 1)
    for (row, col), (i, j), height in zip(
        places, grid.places(points), grid.heights_at(points), strict=True
    ):
        assert abs(i - row) < 2e-6
        assert abs(j - col) < 2e-6
        if 0.0 <= i <= rows and 0.0 <= j <= cols:
            np.testing.assert_allclose(height, bilinear(heights, i, j), rtol=1e-9, atol=1e-9)
        else:
            assert np.isnan(height)


def test_heights_on_the_border_belong_to_the_raster_and_none_beyond_it():
    grid = rtin.Grid([[0.0, 10.0, 20.0], [40.0, 50.0, 60.0]])
    on_it = [[0.5, 0], [1.5, -1], [0, -0.25], [2, -0.75], [2, -1], [0, 0]]
    assert grid.heights_at(on_it).tolist() == [5.0, 55.0, 10.0, 50.0, 60.0, 0.0]
    beyond = [[-1e-5, 0], [0, 1e-5], [2 + 1e-5, -1], [2, -1 - 1e-5], [3, 0], [0, -2], [-1, 1]]
    assert np.isnan(grid.heights_at(beyond)).all()


def test_a_millionth_of_a_cell_from_a_sample_is_at_it():
    grid = rtin.Grid([[0.0, 1e6], [2e6, 3e6]], (1000, 0, 5e6, 0, -1000, 4e6))
    corner, near = (
        np.array([5e6 + 1000, 4e6]),
        0.0009 * np.array([[1, 0], [-1, 0], [0, 1], [1, -1]]),
    )
    assert grid.heights_at(corner + near).tolist() == [1e6] * 4
    far = corner - [[0.002, 0], [0, 0.002]]
    np.testing.assert_allclose(grid.heights_at(far), [1e6 - 2, 1e6 + 4], rtol=0, atol=0.01)
    assert np.isnan(grid.heights_at([[5e6 + 1000.002, 4e6]])[0])


def test_a_void_counts_only_where_it_has_a_share():
    heights = np.arange(12.0).reshape(3, 4)
    heights[1, 1] = np.nan
    grid = rtin.Grid(heights)
    beside = [[0, -1], [2, -1], [1, 0], [1, -2], [2, -0.5], [0.5, 0], [0, -1.5], [2.5, -1.5]]
    assert grid.heights_at(beside).tolist() == [4.0, 6.0, 1.0, 9.0, 4.0, 0.5, 6.0, 8.5]
    touching = [[1, -1], [1, -0.5], [0.5, -1], [1.5, -1], [1, -1.5], [0.1, -0.1], [1.9, -1.9]]
    assert np.isnan(grid.heights_at(touching)).all()


def test_a_plane_is_a_plane_everywhere():
    row, col = np.indices((7, 5))
    transform = terrains.UTM @ Affine.rotation(33.0) @ Affine.scale(2.0, -2.0)
    grid = rtin.Grid(3.0 * row - 2.0 * col, transform)
    places = np.random.default_rng(1).random((200, 2)) * (6, 4)
    at = grid.heights_at(world(transform, places))
    np.testing.assert_allclose(at, places @ (3.0, -2.0), atol=1e-6)


def test_takes_no_points_and_lists_and_whole_numbers():
    grid = rtin.Grid([[0, 1], [2, 3]])
    assert grid.heights_at(np.empty((0, 2))).tolist() == []
    assert grid.places(np.empty((0, 2))).shape == (0, 2)
    assert grid.heights_at([[1, -1]]).tolist() == [3.0]
    assert grid.places([[1, -1]]).tolist() == [[1.0, 1.0]]


@pytest.mark.parametrize("transform", meshes.TRANSFORMS)
def test_points_that_are_nowhere_have_no_height(transform):
    grid = rtin.Grid([[0, 1], [2, 3]], meshes.TRANSFORMS[transform])
    nowhere = [
        [np.nan, 0],
        [0, np.nan],
        [np.inf, 0],
        [0, -np.inf],
        [np.inf, np.inf],
        [1e308, 1e308],
    ]
    assert np.isnan(grid.heights_at(nowhere)).all()


@pytest.mark.parametrize("wrong", [[], [1.0, 2.0], [[1.0, 2.0, 3.0]], [[1.0]], [[[1.0, 2.0]]], 5.0])
def test_says_what_shape_points_have(wrong):
    grid = rtin.Grid([[0, 1], [2, 3]])
    for ask in (grid.places, grid.heights_at):
        with pytest.raises(ValueError, match=r"points must have shape \(n, 2\), got \("):
            ask(wrong)


def test_bounds_are_those_of_all_samples():
    heights = np.array([[1.0, np.nan, 3.0], [-2.0, 5.0, np.nan]])
    turned = rtin.Grid(heights, (2.0, 1.0, 100.0, 1.0, -3.0, 50.0))
    assert turned.bounds.tolist() == [[100.0, 47.0, -2.0], [105.0, 52.0, 5.0]]


@pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, lambda grid: pickle.loads(pickle.dumps(grid))],
    ids=["copy", "deepcopy", "pickle"],
)
def test_heights_stay_as_they_are_in_copies(copied):
    grid = copied(rtin.Grid(np.ones((2, 3)), crs=32633))
    assert not grid.heights.flags.writeable
    assert (grid.heights == 1.0).all()
    assert grid.crs.to_epsg() == 32633
