"""``rtin tiles``: rasters of every kind, and every way in which a run may end early."""

import gzip
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from affine import Affine
from typer.testing import CliRunner

import quantized_mesh_decoder as decoder
from rtin import cli
from rtin.io.live_tiles import LiveTiles
from rtin.io.tile_jobs import world_tiles
from rtin.schemes import SCHEMES
from test_pyramid import rough
from test_tileset import contents

ALPS = Affine(0.01, 0.0, 7.0, 0.0, -0.01, 46.0)
SHAPE = 120, 160


def raster(path, heights, transform=ALPS, crs="EPSG:4326", **options):
    """Write a GeoTIFF; NaN is its nodata."""
    n_rows, n_cols = heights.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=n_rows, width=n_cols, count=1, dtype=heights.dtype,
        transform=transform, crs=crs, nodata=np.nan, **options,
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return path


def moved(lon, lat=46.0, step=0.01):
    return Affine(step, 0.0, lon, 0.0, -step, lat)


def half_void(*, random):
    heights = rough(*SHAPE, voids=0.5 if random else 0.0)
    if not random:
        heights[:, : SHAPE[1] // 2] = np.nan
    return heights


def run(*arguments):
    return CliRunner().invoke(cli.app, ["tiles", *map(str, arguments)])


def made(*arguments):
    """The summary of a run that succeeds."""
    result = run(*arguments, "--workers", 1, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def started(*arguments, **options):
    """A run in a process of its own, and in a group of processes that can be looked for."""
    return subprocess.Popen(
        [sys.executable, "-m", "rtin", "tiles", *map(str, arguments)], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, **options,
    )  # fmt: skip


def one_line(stderr):
    """What is said last on stderr, which holds no traceback."""
    assert "Traceback" not in stderr
    *notes, line = stderr.splitlines()
    assert all(note.startswith("rtin: ") for note in notes)
    return line


# --- what a folder of terrain must hold ---------------------------------------------------------


def checked(folder, scheme="geographic"):
    """Check all tiles of a folder, and how they meet; return {(zoom, x, y): decoded tile}."""
    layer = json.loads((folder / "layer.json").read_text())
    tiles = {}
    for path in folder.rglob("*.terrain"):
        zoom, x, y = (int(part) for part in path.with_suffix("").parts[-3:])
        bounds = SimpleNamespace(
            edges=SCHEMES[scheme].bounds(zoom, (1 << zoom) - 1 - y, x),
            is_mercator=scheme == "mercator",
        )
        tiles[zoom, x, y] = decoder.check(gzip.decompress(path.read_bytes()), bounds)
    assert set(tiles) == available(layer)
    for zoom in {zoom for zoom, _, _ in tiles}:
        require_no_crack({(x, y): t for (z, x, y), t in tiles.items() if z == zoom},
                         SCHEMES[scheme].roots << zoom)  # fmt: skip
    assert all((zoom - 1, x // 2, y // 2) in tiles for zoom, x, y in tiles if zoom)
    return tiles


def available(layer):
    places = [
        (zoom, x, y)
        for zoom, rectangles in enumerate(layer["available"])
        for r in rectangles
        for x in range(r["startX"], r["endX"] + 1)
        for y in range(r["startY"], r["endY"] + 1)
    ]
    assert len(places) == len(set(places))
    assert len(layer["available"]) == layer["maxzoom"] + 1
    return set(places)


def require_no_crack(tiles, n_cols):
    """Tiles side by side share the vertices of their border: place, height and normal."""
    n_pairs = 0
    for (x, y), tile in tiles.items():
        for other, ours, theirs in (
            (((x + 1) % n_cols, y), "east", "west"),
            ((x, y + 1), "north", "south"),
        ):
            if other in tiles:
                assert border(tile, ours) == border(tiles[other], theirs)
                n_pairs += 1
    assert n_pairs or len(tiles) == 1


def border(tile, side):
    """{place along the border: (height, normal)} of a side."""
    number, along = {
        "west": (0, tile.v), "south": (1, tile.u), "east": (2, tile.v), "north": (3, tile.u)
    }[side]  # fmt: skip
    octs = tile.extensions[decoder.OCT_NORMALS].reshape(-1, 2)
    return {int(along[i]): (tile.heights[i], bytes(octs[i])) for i in tile.edges[number]}


# --- rasters of every kind ----------------------------------------------------------------------

KINDS = {
    "geographic": lambda path: raster(path, rough(*SHAPE)),
    "float64, few cells": lambda path: raster(
        path, rough(3, 4, dtype=np.float64), moved(7, 46, 0.5)
    ),
    "UTM": lambda path: raster(
        path, rough(*SHAPE), Affine(900, 0, 4e5, 0, -1100, 5e6), "EPSG:32632"
    ),
    "UTM in the south, turned": lambda path: raster(
        path, rough(*SHAPE), Affine(900, 300, 4e5, 250, -1100, 7e6), "EPSG:32733"
    ),
    "Mercator": lambda path: raster(
        path, rough(*SHAPE), Affine(1e3, 0, 8e5, 0, -1e3, 6e6), "EPSG:3857"
    ),
    "170 to 190": lambda path: raster(path, rough(*SHAPE), moved(170, 5, 0.125)),
    "-190 to -170": lambda path: raster(path, rough(*SHAPE), moved(-190, 5, 0.125)),
    "0 to 360": lambda path: raster(path, rough(90, 180), moved(0, 90, 2.0)),
    "half of it void": lambda path: raster(path, half_void(random=False)),
    "every second one void": lambda path: raster(path, half_void(random=True)),
    "the north pole": lambda path: raster(
        path, rough(*SHAPE), Affine(2e4, 0, -16e5, 0, -2e4, 12e5), "EPSG:3413"
    ),
}


@pytest.mark.parametrize("scheme", ["geographic", "mercator"])
@pytest.mark.parametrize("kind", KINDS)
def test_rasters_of_every_kind_become_tiles_without_cracks(tmp_path, kind, scheme):
    dem, out = KINDS[kind](tmp_path / "dem.tif"), tmp_path / "tiles"
    summary = made(dem, out, "--scheme", scheme, "--cells", 16)
    tiles = checked(out, scheme)
    assert summary["tiles"] == summary["made"] == len(tiles)
    assert summary["bytes"] == sum(path.stat().st_size for path in out.rglob("*.terrain"))
    for level in summary["levels"]:
        assert level["max_error"] <= level["tolerance"]
        assert level["n_tiles"] == sum(zoom == level["zoom"] for zoom, _, _ in tiles)
    highest = max(tile.heights.max() for (zoom, _, _), tile in tiles.items())
    assert 100.0 < highest <= 1000.5 or kind == "the north pole"
    again = made(dem, out, "--scheme", scheme, "--cells", 16)
    assert again["made"] == again["removed"] == 0


def test_heights_are_where_the_raster_has_them(tmp_path):
    """Tiles of rasters on either side of the antimeridian, and counted from 0 or from -180."""
    world = rough(90, 180)
    raster(tmp_path / "a.tif", world, moved(0, 90, 2.0))
    raster(tmp_path / "b.tif", np.roll(world, 90, axis=1), moved(-180, 90, 2.0))
    part = rough(40, 60)
    raster(tmp_path / "c.tif", part, moved(170, 10, 0.5))
    raster(tmp_path / "d.tif", part, moved(-190, 10, 0.5))
    for one, other in ("ab", "cd"):
        for name in (one, other):
            made(tmp_path / f"{name}.tif", tmp_path / name, "--cells", 16)
        tiles = contents(tmp_path / one), contents(tmp_path / other)
        for each in tiles:
            each.pop("layer.json")  # holds the name of the raster
        assert tiles[0] == tiles[1]
        assert len(tiles[0]) > 10


def test_a_vrt_and_two_files_are_as_one(tmp_path):
    heights = rough(*SHAPE)
    whole = raster(tmp_path / "whole.tif", heights)
    west = raster(tmp_path / "west.tif", np.ascontiguousarray(heights[:, :70]))
    east = raster(tmp_path / "east.tif", np.ascontiguousarray(heights[:, 70:]), moved(7.7))
    vrt = tmp_path / "both.vrt"
    vrt.write_text(vrt_of(west, east))
    for name, dems in (("whole", [whole]), ("both", [west, east]), ("vrt", [vrt])):
        made(*dems, tmp_path / name, "--cells", 16)
    wanted = contents(tmp_path / "whole")
    for name in ("both", "vrt"):
        found = contents(tmp_path / name)
        assert {n for n in wanted if found.get(n) != wanted[n]} <= {"layer.json"}
        assert found.keys() == wanted.keys()


def vrt_of(west, east):
    def source(path, first, n_cols):
        return (
            f"<SimpleSource><SourceFilename>{path}</SourceFilename><SourceBand>1</SourceBand>"
            f'<SrcRect xOff="0" yOff="0" xSize="{n_cols}" ySize="120"/>'
            f'<DstRect xOff="{first}" yOff="0" xSize="{n_cols}" ySize="120"/></SimpleSource>'
        )

    return (
        '<VRTDataset rasterXSize="160" rasterYSize="120"><SRS>EPSG:4326</SRS>'
        "<GeoTransform>7, 0.01, 0, 46, 0, -0.01</GeoTransform>"
        '<VRTRasterBand dataType="Float32" band="1"><NoDataValue>nan</NoDataValue>'
        f"{source(west, 0, 70)}{source(east, 70, 90)}</VRTRasterBand></VRTDataset>"
    )


def test_served_tiles_are_those_of_the_folder(tmp_path):
    dem = raster(tmp_path / "dem.tif", half_void(random=False), moved(179.2))
    options = {"cells": 16, "zoom": (None, 9), "max_error": [20.0]}
    made(dem, tmp_path / "tiles", "--cells", 16, "--zoom", "0-9", "--max-error", 20)
    job = world_tiles([dem], about={"name": "dem.tif", "attribution": ""}, **options)
    live = LiveTiles(job, tmp_path / "live")
    layer = json.loads((tmp_path / "tiles" / "layer.json").read_text())
    assert live.layer == layer
    assert (live.minzoom, live.maxzoom) == (0, 9)
    for zoom, x, y in available(layer):
        path = tmp_path / "tiles" / str(zoom) / str(x) / f"{y}.terrain"
        assert live.terrain(zoom, x, y) == path.read_bytes()
    assert live.terrain(9, 0, 0) is None
    assert sum(live.health()["tiles"].values()) == len(available(layer))


# --- what is refused ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    return raster(tmp_path_factory.mktemp("dem") / "dem.tif", rough(*SHAPE))


@pytest.mark.parametrize(
    ("options", "code", "wanted"),
    [
        (["--zoom", "3-1"], 1, "zooms must rise within 0 to 24, got 3 to 1"),
        (["--zoom", "0-30"], 1, "zooms must rise within 0 to 24, got 0 to 30"),
        (["--zoom", "x"], 2, "--zoom wants one zoom or two, such as 0-12, got 'x'"),
        (["--zoom", "3-"], 2, "--zoom wants one zoom or two"),
        (["--zoom", "-3"], 2, "--zoom wants one zoom or two"),
        (["--zoom", "0-3", "--max-error", "4,2"], 1, "one for each of the 4 zooms 0 to 3, got 2"),
        (["--zoom", "0-1", "--max-error", "1,2"], 1, "tolerances must not grow with the zoom"),
        (["--max-error", "-1"], 1, "got -1"),
        (["--max-error", "nan"], 2, "--max-error wants numbers, got 'nan'"),
        (["--max-error", "a"], 2, "--max-error wants numbers, got 'a'"),
        (["--cells", "100"], 1, "cells must be a power of two from 2 to 16384, got 100"),
        (["--cells", "0"], 1, "cells must be a power of two"),
        (["--fill", "high"], 2, "--fill wants numbers, got 'high'"),
        (["--format", "gltf"], 2, "'gltf' is not one of"),
        (["--workers", "0"], 2, "Invalid value for '--workers'"),
        (["--band", "2"], 1, "band"),
        (["--format", "obj"], 1, "max_error is needed"),
        (["--local"], 2, "--local goes with --format glb"),
        (["--format", "glb", "--fill", "0"], 2, "--fill goes with --format terrain or 3dtiles"),
    ],
)
def test_options_that_make_no_sense_are_one_line(dem, tmp_path, options, code, wanted):
    result = run(dem, tmp_path / "tiles", *options)
    assert result.exit_code == code
    said = " ".join(re.sub("[│╭╮╰╯─]", "", result.stderr).split())
    assert wanted in said
    assert "Traceback" not in said
    assert code == 2 or len(result.stderr.splitlines()) == 1
    assert not (tmp_path / "tiles").exists()


def test_paths_that_make_no_sense_are_one_line(dem, tmp_path):
    (tmp_path / "file").write_text("mine")
    bare = raster(tmp_path / "bare.tif", rough(*SHAPE), crs=None)
    for arguments, wanted in (
        ([dem, tmp_path / "file"], "file is a file; name a folder for the tiles"),
        ([tmp_path / "none.tif", tmp_path / "tiles"], "none.tif"),
        ([tmp_path / "file", tmp_path / "tiles"], "file"),
        ([bare, tmp_path / "tiles"], "bare.tif has no CRS"),
        ([dem, tmp_path / "file" / "tiles"], "file"),
        ([dem, tmp_path], "is not empty and holds no tileset"),
        ([dem, dem, tmp_path / "tiles", "--format", "obj", "--max-error", 1], "takes one raster"),
    ):
        result = run(*arguments, "--workers", 1)
        assert result.exit_code == 1
        assert wanted in one_line(result.stderr)
        assert not (tmp_path / "tiles").exists()
    assert (tmp_path / "file").read_text() == "mine"
    assert run(dem).exit_code == 2


def test_folders_above_are_made(dem, tmp_path):
    made(dem, tmp_path / "a" / "b" / "tiles", "--zoom", 3)
    assert (tmp_path / "a" / "b" / "tiles" / "layer.json").exists()


# --- runs that end early ------------------------------------------------------------------------

SLOW = ("--cells", 16, "--zoom", "0-11", "--max-error", 1)


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """A raster of many tiles, and what becomes of it in one go."""
    folder = tmp_path_factory.mktemp("wide")
    heights = rough(*SHAPE)
    dem = raster(
        folder / "dem.tif", heights, compress="deflate", tiled=True, blockxsize=64, blockysize=64
    )
    made(dem, folder / "tiles", *SLOW)
    return SimpleNamespace(dem=dem, tiles=folder / "tiles", contents=contents(folder / "tiles"))


def await_tiles(process, out, number=200):
    while len(list(out.rglob("*.terrain"))) < number:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)


def members(group):
    """Processes of a group that run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == group and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def await_nobody(group):
    for _ in range(600):
        if not members(group):
            return
        time.sleep(0.05)
    raise AssertionError(f"processes {members(group)} go on")


def require_finished_by_another_run(wide, out):
    had = contents(out)
    assert {name for name in had if not Path(name).name.startswith(".")} == {
        name for name, data in had.items() if wide.contents.get(name) == data
    }
    summary = made(wide.dem, out, *SLOW)
    assert contents(out) == wide.contents
    assert summary["made"] < summary["tiles"]
    assert not list(out.rglob("*.part*"))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_run_is_finished_by_the_next(wide, tmp_path, workers):
    out = tmp_path / "tiles"
    process = started(wide.dem, out, *SLOW, "--workers", workers)
    await_tiles(process, out)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert "layer.json" not in contents(out)  # it was in the middle
    await_nobody(process.pid)
    require_finished_by_another_run(wide, out)


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_ends_all_processes_and_loses_nothing(wide, tmp_path, workers):
    out = tmp_path / "tiles"
    process = started(wide.dem, out, *SLOW, "--workers", workers)
    await_tiles(process, out)
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in stderr
    await_nobody(process.pid)
    assert "layer.json" not in contents(out)
    require_finished_by_another_run(wide, out)


def test_a_worker_that_is_killed_is_one_line(wide, tmp_path):
    out = tmp_path / "tiles"
    process = started(wide.dem, out, *SLOW, "--workers", 2)
    await_tiles(process, out)
    busiest = max(set(members(process.pid)) - {process.pid}, key=used_time)
    os.kill(busiest, signal.SIGKILL)
    _, stderr = process.communicate()
    assert process.returncode == 1
    assert "a worker process was ended, perhaps for want of memory" in one_line(stderr)
    await_nobody(process.pid)
    require_finished_by_another_run(wide, out)


def used_time(number):
    return int(Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[11])


@pytest.mark.parametrize("workers", [1, 2])
def test_a_damaged_block_is_one_line_and_nothing_is_lost(wide, tmp_path, workers):
    dem, out = Path(shutil.copy(wide.dem, tmp_path / "dem.tif")), tmp_path / "tiles"
    right = dem.read_bytes()
    place = len(right) // 2
    dem.write_bytes(right[:place] + bytes(200) + right[place + 200 :])
    result = run(dem, out, *SLOW, "--workers", workers)
    assert result.exit_code == 1
    assert "dem.tif" in one_line(result.stderr)
    assert contents(out).items() <= wide.contents.items()
    dem.write_bytes(right)
    summary = made(dem, out, *SLOW, "--update")
    assert summary["tiles"] == len(wide.contents) - 1
    assert contents(out) == wide.contents


def test_a_block_damaged_later_keeps_what_was_finished(wide, tmp_path):
    dem, out = Path(shutil.copy(wide.dem, tmp_path / "dem.tif")), tmp_path / "tiles"
    made(dem, out, *SLOW)
    right = dem.read_bytes()
    place = len(right) // 2
    dem.write_bytes(right[:place] + bytes(200) + right[place + 200 :])
    assert "add --update" in one_line(run(dem, out, *SLOW).stderr)
    result = run(dem, out, *SLOW, "--update", "--workers", 1)
    assert result.exit_code == 1
    assert "dem.tif" in one_line(result.stderr)
    assert contents(out) == wide.contents
    dem.write_bytes(right)
    made(dem, out, *SLOW, "--update")
    assert contents(out) == wide.contents


@pytest.mark.parametrize("most", [0, 2000, 30_000])
def test_files_that_may_not_grow_are_one_line(wide, tmp_path, most):
    """Like a full disk: nothing can be written beyond some bytes."""
    out = tmp_path / "tiles"
    process = started(
        wide.dem, out, *SLOW, "--workers", 1,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
    )  # fmt: skip
    _, stderr = process.communicate()
    assert process.returncode == 1, stderr
    assert str(out) in one_line(stderr)
    assert contents(out).items() <= wide.contents.items()
    made(wide.dem, out, *SLOW)
    assert contents(out) == wide.contents


@pytest.mark.parametrize(("size", "workers"), [("64k", 1), ("400k", 1), ("1m", 1), ("1m", 2)])
def test_a_full_disk_is_one_line_and_nothing_is_lost(wide, tmp_path, size, workers):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("mounting a small disk is not allowed here")
    try:
        result = run(wide.dem, disk / "tiles", *SLOW, "--workers", workers)
        assert result.exit_code == 1
        assert "disk" in one_line(result.stderr)
        assert contents(disk / "tiles").items() <= wide.contents.items()
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        made(wide.dem, disk / "tiles", *SLOW)
        assert contents(disk / "tiles") == wide.contents
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)
