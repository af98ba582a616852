"""`coarsen_lattice` against `coarsen`: the same bytes, whatever is in memory at a time."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import rasterio
import rasterio.control
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rtin
import terrains
from rtin import cli
from rtin._memory import as_bytes, as_text
from rtin.io.grids import FillValues, suspicious_values
from rtin.out_of_core import LatticeWindow, coarsen_lattice, lattice_error, memory_of_coarsen

NORTH_UP = terrains.TRANSFORMS["north up"]


class ArrayLattice:
    """Heights in memory that are read window by window; counts the largest window."""

    period = None

    def __init__(self, heights, transform=NORTH_UP, crs=None, first=(0, 0)):
        self.heights = np.asarray(heights)
        self.rows, self.cols = ((i, i + n) for i, n in zip(first, self.heights.shape, strict=True))
        self.transform, self.crs = transform, crs
        self.largest_window = self.samples_read = 0

    def read(self, rows, cols):
        shape = rows[1] - rows[0], cols[1] - cols[0]
        self.largest_window = max(self.largest_window, shape[0] * shape[1])
        self.samples_read += shape[0] * shape[1]
        window = np.full(shape, np.nan, self.heights.dtype)
        row, col = rows[0] - self.rows[0], cols[0] - self.cols[0]
        inside = self.heights[max(row, 0) : row + shape[0], max(col, 0) : col + shape[1]]
        down, right = max(-row, 0), max(-col, 0)
        window[down : down + inside.shape[0], right : right + inside.shape[1]] = inside
        return window


def coarsened(make):
    try:
        return make()
    except ValueError as error:
        return str(error)


def assert_same(grid, max_error, cells, memory=1, lattice=None):
    """Both ways give the same bytes, or the same complaint."""
    whole = coarsened(lambda: rtin.coarsen(grid, max_error=max_error))
    lattice = lattice or ArrayLattice(grid.heights, grid.transform, grid.crs)
    # So little memory that two blocks at most are at hand.
    options = {"max_error": max_error, "cells": cells, "memory": memory}
    parts = coarsened(lambda: coarsen_lattice(lattice, **options))
    if isinstance(whole, str):
        assert parts == whole
        return
    assert parts.vertices.tobytes() == whole.vertices.tobytes()
    assert parts.triangles.tobytes() == whole.triangles.tobytes()
    assert parts.triangles.dtype == whole.triangles.dtype
    assert parts.crs == whole.crs


@pytest.fixture(autouse=True)
def room_for_meshes(monkeypatch):
    """Let meshes grow beyond the little memory that makes blocks few."""
    monkeypatch.setattr("rtin.out_of_core._BYTES_OF_VERTEX", 0)


# --- the same mesh ------------------------------------------------------------------------------


@pytest.mark.parametrize("holes", terrains.HOLES)
@pytest.mark.parametrize("shape", [(2, 9), (9, 9), (10, 10), (17, 23), (13, 40), (33, 33)], ids=str)
def test_is_the_mesh_of_coarsen_on_every_shape_and_hole(shape, holes):
    for number, terrain in enumerate(terrains.GALLERY.values()):
        heights = terrains.pierced(terrain(shape), terrains.HOLES[holes](shape))
        grid = rtin.Grid(heights.astype(np.float32))
        for cells in (4, 8):
            assert_same(grid, [0.0, 0.5, 3.0, 20.0][number % 4], cells)


@given(
    terrains.rasters(largest=20),
    terrains.tolerances,
    st.sampled_from([2, 4, 8, 16]),
    st.sampled_from(list(terrains.TRANSFORMS.values())),
)
def test_is_the_mesh_of_coarsen_on_any_terrain(heights, max_error, cells, transform):
    assert_same(rtin.Grid(heights, transform), max_error, cells)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([9, 17, 18]), st.sampled_from([2, 4, 8]))
def test_rounds_as_coarsen_does(seed, side, cells):
    rng = np.random.default_rng(seed)
    # Planes, and what is left of them where float64 has no more bits: ties everywhere.
    row, col = np.indices((side, side))
    heights = 0.1 * row + row * col / 3 * rng.integers(0, 2) + rng.random() * col
    heights[rng.random((side, side)) < 0.02 * rng.integers(0, 2)] += 0.3
    grid = rtin.Grid(heights)
    assert grid.heights.dtype == np.float64
    error = rtin.vertical_error(rtin.coarsen(grid, max_error=0.2), grid).max
    for max_error in (0.0, error, 0.3):
        assert_same(grid, max_error, cells)


@pytest.mark.parametrize("shape", [(65, 65), (70, 40)])
def test_a_flat_sea_stays_a_few_triangles_larger_than_blocks(shape):
    heights = np.zeros(shape, np.float32)
    lattice = ArrayLattice(heights)
    mesh = coarsen_lattice(lattice, max_error=0.5, cells=4, memory=1)
    areas = abs(mesh.signed_areas())
    assert areas.max() > 4 * 4  # of a block
    assert_same(rtin.Grid(heights), 0.5, 4)
    heights[-2, 3] = 9.0  # an island
    assert_same(rtin.Grid(heights), 0.5, 4)


@pytest.mark.parametrize("memory", [1, 20_000, 10**9])
@pytest.mark.parametrize("n_threads", ["1", "2"])
def test_neither_memory_nor_threads_change_a_byte(monkeypatch, memory, n_threads):
    monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
    heights = terrains.pierced(terrains.waves((150, 170)), terrains.pond((150, 170)))
    assert_same(rtin.Grid(heights.astype(np.float32)), 3.0, 16, memory)


def test_rows_and_columns_need_not_start_at_zero():
    grid = rtin.Grid(terrains.waves((20, 30)), terrains.UTM)
    lattice = ArrayLattice(grid.heights, terrains.UTM, first=(-7, 100))
    moved = rtin.Grid(grid.heights, terrains.UTM @ terrains.Affine.translation(100, -7))
    assert_same(moved, 2.0, 8, lattice=lattice)


def test_a_window_is_a_raster_of_its_own():
    grid = rtin.Grid(terrains.waves((40, 50)))
    window = LatticeWindow(ArrayLattice(grid.heights), (5, 30), (9, 47))
    part = rtin.Grid(grid.heights[5:30, 9:47], NORTH_UP @ terrains.Affine.translation(9, 5))
    assert_same(part, 2.0, 8, lattice=window)
    assert np.isnan(window.read((0, 5), (9, 47))).all()
    assert np.isnan(window.read((4, 31), (8, 48))).sum() == 2 * (27 + 40) - 4


@pytest.mark.parametrize("rows", [(-1, 5), (5, 5), (35, 41)])
def test_a_window_must_lie_within_its_lattice(rows):
    with pytest.raises(ValueError, match="must lie within rows"):
        LatticeWindow(ArrayLattice(terrains.waves((40, 50))), rows, (0, 50))


@pytest.mark.parametrize("value", [np.nan, 7.0])
def test_blocks_without_heights_or_relief(value):
    heights = np.full((33, 33), value, np.float32)
    heights[3:7, 2:9] = terrains.noise((4, 7))
    assert_same(rtin.Grid(heights), 1.0, 4)


# --- what is read -------------------------------------------------------------------------------


def test_reads_a_few_blocks_at_a_time_and_each_a_few_times():
    heights = terrains.waves((257, 250)).astype(np.float32)
    lattice = ArrayLattice(heights)
    coarsen_lattice(lattice, max_error=2.0, cells=16, memory=20 * 17 * 17 * 5)
    assert lattice.largest_window <= 5 * 17 * 17
    assert lattice.samples_read < 5 * heights.size


def test_tells_how_far_it_is():
    shares = []
    lattice = ArrayLattice(terrains.waves((65, 65)))
    coarsen_lattice(lattice, max_error=1.0, cells=8, memory=1, tell=shares.append)
    assert min(shares) >= 0.0
    assert max(shares) == 1.0
    assert len(shares) > 10


# --- the achieved error -------------------------------------------------------------------------


@pytest.mark.parametrize("memory", [1, 10_000, 10**9])
def test_measures_as_vertical_error_does(memory):
    heights = terrains.pierced(terrains.waves((70, 90)), terrains.pond((70, 90)))
    heights[:9, :9] = np.nan
    heights[4, 4] = 1.0  # no triangle there
    grid = rtin.Grid(heights, terrains.UTM)
    mesh = rtin.coarsen(grid, max_error=3.0)
    whole = rtin.vertical_error(mesh, grid)
    parts = lattice_error(mesh, ArrayLattice(heights, terrains.UTM), memory=memory)
    assert whole.n_uncovered > 0
    for name in ("max", "sample", "n_samples", "n_uncovered"):
        assert getattr(parts, name) == getattr(whole, name)
    assert parts.rms == pytest.approx(whole.rms, rel=1e-12)
    assert parts.mean == pytest.approx(whole.mean, rel=1e-12)


def test_a_mesh_elsewhere_is_refused():
    grid = rtin.Grid(terrains.waves((9, 9)), terrains.UTM)
    mesh = rtin.coarsen(grid, max_error=3.0)
    with pytest.raises(ValueError, match="covers no sample"):
        lattice_error(mesh, ArrayLattice(grid.heights))


@given(st.lists(st.sampled_from([-9999.0, -32768.0, 9999.0, 1e10, 3.0, -5.0, np.nan]), min_size=4))
def test_finds_suspicious_values_part_by_part(values):
    heights = np.array([*values, 1.0], np.float32)[:, np.newaxis].repeat(2, axis=1)
    seen = FillValues()
    for row in heights:
        seen.look(row)
    assert seen.lines() == suspicious_values(rtin.Grid(heights))


# --- the door -----------------------------------------------------------------------------------


@pytest.mark.parametrize("cells", [0, 1, 3, 48, -4])
def test_refuses_blocks_that_are_no_power_of_two(cells):
    with pytest.raises(ValueError, match=f"power of two from 2 to 16384, got {cells}"):
        coarsen_lattice(ArrayLattice(terrains.waves((9, 9))), max_error=1.0, cells=cells)


def test_refuses_what_coarsen_refuses():
    lattice = ArrayLattice(terrains.waves((9, 9)))
    with pytest.raises(ValueError, match="zero or more"):
        coarsen_lattice(lattice, max_error=-1.0, cells=4)
    with pytest.raises(ValueError, match="2 × 2"):
        coarsen_lattice(ArrayLattice(np.zeros((1, 5))), max_error=1.0)
    with pytest.raises(ValueError, match=r"no value at all|no triangle"):
        coarsen_lattice(ArrayLattice(np.full((9, 9), np.nan)), max_error=1.0, cells=4)


def test_a_mesh_that_does_not_fit_is_refused_clearly(monkeypatch):
    monkeypatch.setattr("rtin.out_of_core._BYTES_OF_VERTEX", 120)
    lattice = ArrayLattice(terrains.noise((65, 65)))
    with pytest.raises(MemoryError, match=r"more than .* vertices.*allow a larger error"):
        coarsen_lattice(lattice, max_error=0.0, cells=8, memory=300_000)
    assert coarsen_lattice(lattice, max_error=0.0, cells=8, memory=900_000).n_vertices == 65 * 65


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("500MB", 500_000_000), ("2GB", 2 * 10**9), ("1.5GiB", 3 * 2**29), ("64 k", 64_000),
        ("1mib", 2**20), ("2g", 2 * 10**9), ("1000", 1000), ("1TB", 10**12), (".5 MB", 500_000),
    ],
)  # fmt: skip
def test_reads_sizes_of_memory(text, size):
    assert as_bytes(text) == size


@pytest.mark.parametrize("text", ["", "much", "-2GB", "0", "2XB", "2 iB", "1e9", "nan", "2GB2"])
def test_refuses_other_texts_as_sizes(text):
    with pytest.raises(ValueError, match="such as 500MB, 2GB"):
        as_bytes(text)


@pytest.mark.parametrize("size", [12_000, 500_000_000, 3 * 10**9])
def test_writes_sizes_that_it_reads(size):
    assert as_bytes(as_text(size)) == size


# --- the command line ---------------------------------------------------------------------------


@pytest.fixture
def dem(tmp_path):
    path = tmp_path / "dem.tif"
    heights = terrains.pierced(terrains.waves((700, 500)), terrains.pond((700, 500)))
    heights[np.isnan(heights)] = -9.5
    profile = {"driver": "GTiff", "height": 700, "width": 500, "count": 1, "dtype": "float32"}
    placed = {"crs": "EPSG:32632", "transform": terrains.UTM @ terrains.Affine.scale(30, -30)}
    with rasterio.open(path, "w", **profile, **placed, nodata=-9.5, tiled=True) as dataset:
        dataset.write(heights.astype(np.float32), 1)
    return path


def run(*arguments):
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


@pytest.mark.parametrize("window", [[], ["--window", 100, 650, 20, 477]])
@pytest.mark.parametrize("name", ["out.glb", "out.ply"])
def test_a_raster_beyond_the_limit_gives_the_same_file(dem, tmp_path, name, window):
    summaries, files = [], []
    for memory in ("1MB", "1GB"):
        options = ("--max-error", 30, "--memory", memory, "--json", *window)
        result = run("coarsen", dem, tmp_path / name, *options)
        assert result.exit_code == 0, result.output
        summaries.append(json.loads(result.stdout))
        files.append((tmp_path / name).read_bytes())
    assert files[0] == files[1]
    in_tiles, whole = summaries
    assert [note for note in in_tiles.pop("notes") if "in tiles" in note]
    assert not [note for note in whole.pop("notes") if "in tiles" in note]
    assert in_tiles.pop("achieved") == pytest.approx(whole.pop("achieved"), rel=1e-12)
    del in_tiles["seconds"], whole["seconds"]
    assert in_tiles == whole


@pytest.mark.filterwarnings("always")
def test_what_is_odd_about_a_raster_is_said_in_tiles_too(tmp_path):
    path, heights = tmp_path / "dem.tif", terrains.waves((600, 600)).astype(np.float32)
    heights[9, 9] = -9999.0
    profile = {"driver": "GTiff", "height": 600, "width": 600, "count": 1, "dtype": "float32"}
    points = [rasterio.control.GroundControlPoint(i, j, i, j) for i, j in ((0, 0), (9, 0), (0, 9))]
    with rasterio.open(path, "w", **profile, gcps=points, crs="EPSG:4326") as dataset:
        dataset.write(heights, 1)
    said = []
    for memory in ("1MB", "1GB"):
        options = ("--max-error", 99, "--memory", memory, "--json")
        result = run("coarsen", path, tmp_path / "a.glb", *options)
        notes = json.loads(result.stdout)["notes"]
        others = [note for note in notes if "in tiles" not in note]
        said.append((result.stderr.splitlines()[0], others))
        assert "ground control" in result.stderr
        assert "undeclared nodata" in str(notes)
    assert said[0] == said[1]


def test_other_options_beyond_the_limit_are_refused_with_advice(dem, tmp_path):
    result = run("coarsen", dem, tmp_path / "a.glb", "--max-vertices", 500, "--memory", "1MB")
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert "--max-error alone" in line
    assert "--window" in line
    result = run("coarsen", dem, tmp_path / "a.glb", "--max-vertices", 5000, "--memory", "1GB")
    assert result.exit_code == 0


def test_a_size_that_is_none_is_bad_usage(dem, tmp_path):
    result = run("coarsen", dem, tmp_path / "a.glb", "--max-error", 5, "--memory", "lots")
    assert result.exit_code == 2
    assert "--memory" in result.stderr
    assert "500MB" in result.stderr


def test_without_a_limit_it_is_half_of_what_is_at_hand(dem, tmp_path, monkeypatch):
    lattice = ArrayLattice(rtin.read_grid(dem).heights)
    for share, expected in ((1, True), (3, False)):
        at_hand = share * memory_of_coarsen(lattice)
        monkeypatch.setattr("rtin.io.grids.available_memory", lambda at_hand=at_hand: at_hand)
        result = run("coarsen", dem, tmp_path / "a.glb", "--max-error", 30)
        assert ("in tiles" in result.stdout) == expected
        # What tiles can't do is tried as before.
        assert run("coarsen", dem, tmp_path / "a.glb", "--max-vertices", 9000).exit_code == 0


def test_a_raster_that_is_not_there_is_said_to_be_so(tmp_path):
    options = ("--max-error", 30, "--memory", "1MB")
    result = run("coarsen", tmp_path / "none.tif", tmp_path / "a.glb", *options)
    assert result.exit_code == 1
    assert "none.tif" in result.stderr


PEAK = """
import ctypes, sys
from pathlib import Path
from rtin import cli

def coarsen(memory, *window):
    options = ["--max-error", "5", "--memory", memory, "--json", *window]
    try:
        cli.app(["coarsen", *sys.argv[1:3], *options])
    except SystemExit as end:
        assert not end.code

def resident(field):
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(field))

# First in small, both ways, for what the program itself takes: compiled code, libraries.
for memory in ("500kB", "1GB"):
    coarsen(memory, "--window", "0", "300", "0", "300")
ctypes.CDLL(None).malloc_trim(0)
Path("/proc/self/clear_refs").write_text("5")  # VmHWM := VmRSS
before = resident("VmRSS")
coarsen(sys.argv[3])
print(resident("VmHWM") - before)
"""


def peak_memory(dem, out, memory):
    done = subprocess.run(
        [sys.executable, "-c", PEAK, dem, out, memory],
        env={**os.environ, "RTIN_NUM_THREADS": "2", "GDAL_CACHEMAX": "16"},
        capture_output=True,
        text=True,
        check=True,
    )
    small_in_tiles, small, large, peak = done.stdout.splitlines()
    assert "in tiles" in small_in_tiles
    assert "in tiles" not in small
    return "in tiles" in large, int(peak)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_stays_within_the_limit(tmp_path):
    dem, side = tmp_path / "dem.tif", 4097
    profile = {"driver": "GTiff", "height": side, "width": side, "count": 1, "dtype": "float32"}
    hill = 300 * np.sin(np.arange(side) / 400)
    with rasterio.open(dem, "w", **profile, tiled=True, transform=terrains.UTM) as dataset:
        for row in range(0, side, 128):
            heights = np.outer(hill[row : row + 128], np.cos(np.arange(side) / 300))
            window = rasterio.windows.Window(0, row, side, len(heights))
            dataset.write(heights.astype(np.float32), 1, window=window)
    was_in_tiles, peak = peak_memory(dem, tmp_path / "tiles.ply", "40MB")
    assert was_in_tiles
    assert peak < 40_000_000
    was_in_tiles, peak = peak_memory(dem, tmp_path / "whole.ply", "9GB")
    assert not was_in_tiles
    assert peak > 4 * side**2
    assert (tmp_path / "whole.ply").read_bytes() == (tmp_path / "tiles.ply").read_bytes()
