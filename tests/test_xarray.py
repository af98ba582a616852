"""xarray in: coordinates, CRS and nodata of a DataArray, and the ``da.rtin`` accessor."""

import subprocess
import sys
import warnings

import numpy as np
import pytest
import rasterio
from affine import Affine

import rtin
from rtin import Grid
from rtin.io.grids import read_grid

xarray = pytest.importorskip("xarray")

HEIGHTS = np.arange(12.0).reshape(3, 4) ** 2
COORDS = {"y": [90.0, 80.0, 70.0], "x": [5.0, 7.0, 9.0, 11.0]}


@pytest.fixture
def array():
    import rtin.accessor  # noqa: F401

    return xarray.DataArray(HEIGHTS, COORDS, ("y", "x"))


def test_coordinates_become_the_transform(array):
    grid = Grid.from_xarray(array)
    assert grid.transform == Affine(2.0, 0.0, 5.0, 0.0, -10.0, 90.0)
    np.testing.assert_array_equal(grid.heights, HEIGHTS)


def test_an_array_without_coordinates_gets_the_transform_of_a_grid():
    grid = Grid.from_xarray(xarray.DataArray(HEIGHTS))
    assert grid.transform == Grid(HEIGHTS).transform
    assert grid.crs is None


@pytest.mark.parametrize("name", ["x", "lon", "longitude"])
def test_an_array_that_runs_along_x_first_is_turned(array, name):
    turned = Grid.from_xarray(array.transpose().rename(x=name))
    np.testing.assert_array_equal(turned.heights, HEIGHTS)
    assert turned.transform == Grid.from_xarray(array).transform


def test_singleton_dimensions_are_dropped_and_longer_ones_refused(array):
    one_band = array.expand_dims(band=[1])
    np.testing.assert_array_equal(Grid.from_xarray(one_band).heights, HEIGHTS)
    with pytest.raises(ValueError, match="select one band or time first"):
        Grid.from_xarray(xarray.concat([one_band, one_band], "band"))


def test_uneven_coordinates_are_refused(array):
    with pytest.raises(ValueError, match="'x' must be evenly spaced"):
        Grid.from_xarray(array.assign_coords(x=[5.0, 7.0, 9.0, 13.0]))


def test_nan_is_void(array):
    grid = Grid.from_xarray(array.where(array != 4))
    np.testing.assert_array_equal(np.argwhere(np.isnan(grid.heights)), [[0, 2]])


old_affine = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # in rioxarray
NORTH_UP, ROTATED = Affine(10, 0, 300, 0, -10, 900), Affine(10, 2, 300, 3, -9, 900)


def write_tif(path, dtype="int16", nodata=-32768, transform=NORTH_UP, scale=(1.0, 0.0)):
    stored = HEIGHTS.astype(dtype)
    stored[1, 1] = nodata
    profile = {"count": 1, "height": 3, "width": 4, "dtype": dtype, "nodata": nodata}
    place = {} if transform is None else {"transform": transform, "crs": "EPSG:32628"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", driver="GTiff", **profile, **place) as file:
            file.write(stored, 1)
            file.scales, file.offsets = [scale[0]], [scale[1]]
    return path


def opened(path, **options):
    rioxarray = pytest.importorskip("rioxarray")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rioxarray.open_rasterio(path, **options) as array:
            return array.load()


@old_affine
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(("dtype", "nodata"), [("int16", -32768), ("float32", -3.4e38)])
def test_rioxarray_and_read_grid_agree(tmp_path, masked, dtype, nodata):
    path = write_tif(tmp_path / "a.tif", dtype, nodata)
    ours, theirs = read_grid(path), Grid.from_xarray(opened(path, masked=masked))
    np.testing.assert_array_equal(theirs.heights, ours.heights)
    assert theirs.transform == ours.transform
    assert theirs.crs == ours.crs
    assert theirs.has_voids


@old_affine
@pytest.mark.parametrize("transform", [NORTH_UP, ROTATED])
@pytest.mark.parametrize("parse_coordinates", [False, True])
def test_rioxarray_and_read_grid_agree_on_the_place(tmp_path, transform, parse_coordinates):
    path = write_tif(tmp_path / "a.tif", transform=transform)
    array = opened(path, parse_coordinates=parse_coordinates)
    ours = read_grid(path)
    for grid in (Grid.from_xarray(array), Grid.from_xarray(array.transpose())):
        assert grid.transform[:6] == pytest.approx(ours.transform[:6], rel=1e-12)
        assert grid.crs == ours.crs


@old_affine
@pytest.mark.parametrize("transform", [NORTH_UP, ROTATED])
def test_a_part_keeps_its_place(tmp_path, transform):
    path = write_tif(tmp_path / "a.tif", transform=transform)
    part = Grid.from_xarray(opened(path)[:, 1:, 2:])
    whole = read_grid(path, window=((1, 3), (2, 4)))
    assert part.transform[:6] == pytest.approx(whole.transform[:6], rel=1e-12)


def test_curved_coordinates_are_refused(tmp_path):
    array = opened(write_tif(tmp_path / "a.tif", transform=ROTATED))
    array.xc[1, 1] += 1.0
    with pytest.raises(ValueError, match="'xc' must be evenly spaced"):
        Grid.from_xarray(array)


@old_affine
def test_a_crs_without_a_place_is_refused(tmp_path):
    array = opened(write_tif(tmp_path / "a.tif", transform=None), parse_coordinates=False)
    assert Grid.from_xarray(array).transform == Grid(HEIGHTS).transform
    with pytest.raises(ValueError, match="neither coordinates nor a transform") as error:
        Grid.from_xarray(array.rio.write_crs("EPSG:32628"))
    assert "\n" not in str(error.value)


@old_affine
@pytest.mark.parametrize("options", [{}, {"masked": True}, {"mask_and_scale": True}])
@pytest.mark.parametrize("dtype", ["int16", "float64"])
def test_scale_and_offset_are_applied_once(tmp_path, options, dtype):
    path = write_tif(tmp_path / "a.tif", dtype, scale=(0.1, -500.0))
    array = opened(path, **options)
    before = array.copy(deep=True)
    grid = Grid.from_xarray(array)
    assert grid.heights.dtype == np.float32 or options == {"mask_and_scale": True}
    np.testing.assert_allclose(grid.heights, read_grid(path).heights, rtol=1e-6)
    xarray.testing.assert_identical(array, before)


def test_scale_offset_and_fill_need_no_rioxarray(tmp_path):
    code = (
        "import sys; sys.modules['rioxarray'] = None; import xarray, rtin;"
        "packed = xarray.DataArray([[1, 2], [3, -1]], "
        "attrs={'scale_factor': 0.5, 'add_offset': 10.0, '_FillValue': -1});"
        "print(rtin.Grid.from_xarray(packed).heights.tolist())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.stdout == "[[10.5, 11.0], [11.5, nan]]\n"


@pytest.mark.parametrize("other", [HEIGHTS, None, "dem.tif", xarray.Dataset({"z": ("x", [1.0])})])
def test_what_is_no_data_array_is_refused(other):
    with pytest.raises(TypeError, match=r"an xarray\.DataArray is wanted, got a") as error:
        Grid.from_xarray(other)
    assert "\n" not in str(error.value)


def test_the_accessor_makes_the_same_mesh_as_the_function(array):
    direct = rtin.coarsen(Grid.from_xarray(array), max_error=2.0)
    mesh = array.rtin.coarsen(max_error=2.0)
    np.testing.assert_array_equal(mesh.vertices, direct.vertices)
    np.testing.assert_array_equal(mesh.triangles, direct.triangles)
    assert mesh.n_vertices < array.size


def test_the_accessor_gives_the_grid(array):
    assert array.rtin.grid.transform == Grid.from_xarray(array).transform


def test_the_accessor_refuses_what_coarsen_refuses(array):
    with pytest.raises(TypeError):
        array.rtin.coarsen(max_eror=2.0)


def test_only_importing_the_accessor_registers_it():
    code = (
        "import rtin, xarray; assert not hasattr(xarray.DataArray, 'rtin');"
        "import rtin.accessor; assert hasattr(xarray.DataArray, 'rtin')"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_without_xarray_the_accessor_says_what_to_install():
    code = "import sys; sys.modules['xarray'] = None; import rtin.accessor"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.stderr.splitlines()[-1].endswith("pip install 'rtin[xarray]'")
