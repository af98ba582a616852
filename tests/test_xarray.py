"""xarray in: coordinates, CRS and nodata of a DataArray, and the ``da.rtin`` accessor."""

import subprocess
import sys

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


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # rioxarray on affine 3
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(("dtype", "nodata"), [("int16", -32768), ("float32", -3.4e38)])
def test_rioxarray_and_read_grid_agree(tmp_path, masked, dtype, nodata):
    rioxarray = pytest.importorskip("rioxarray")
    path = tmp_path / "a.tif"
    stored = HEIGHTS.astype(dtype)
    stored[1, 1] = nodata
    profile = {"count": 1, "height": 3, "width": 4, "dtype": dtype, "nodata": nodata}
    place = {"transform": Affine(10, 0, 300, 0, -10, 900), "crs": "EPSG:32628"}
    with rasterio.open(path, "w", driver="GTiff", **profile, **place) as file:
        file.write(stored, 1)
    ours = read_grid(path)
    with rioxarray.open_rasterio(path, masked=masked) as opened:
        theirs = Grid.from_xarray(opened)
    np.testing.assert_array_equal(theirs.heights, ours.heights)
    assert theirs.transform == ours.transform
    assert theirs.crs == ours.crs
    assert theirs.has_voids


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
