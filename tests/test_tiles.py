"""`tiles` against `coarsen`: one mesh, however it is cut, and in whatever order it is made."""

import random
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

import rtin
import terrains
from lattices import ArrayLattice, decimated, places_of, total, union, union_of_mesh
from rtin import tiles
from rtin.tiles import Tiling, checksum, make_tiles, settle_borders

CELLS = [2, 4, 8, 16]


def corners(shape, cells):
    """The corners of all tiles, as a mask for ``keep``."""
    mask = np.zeros(shape, bool)
    mask[::cells, ::cells] = True
    return mask


def whole(heights, cells, max_error):
    """The mesh that the tiles together are to be."""
    grid = rtin.Grid(heights)
    size = tiles.Tiling.of_raster(ArrayLattice(heights), cells, max_error).cells
    return rtin.coarsen(grid, max_error=max_error, keep=corners(heights.shape, size))


def all_tiles(tiling, **options):
    settled = settle_borders(tiling, **options)
    return list(make_tiles(tiling, tiling.tiles(), settled.borders))


def tiling_of(heights, cells, max_error, **options):
    return Tiling.of_raster(ArrayLattice(heights, **options), cells, max_error)


def terrain(shape=(100, 75), holes=terrains.rotated_swath):
    """Large enough for several blocks when these are made small."""
    return terrains.pierced(terrains.waves(shape) + terrains.noise(shape) / 32, holes(shape))


def rough(shape=(100, 75)):
    """With a tolerance of 6, tiles of 8 cells keep much of their borders for a neighbour's sake."""
    return terrains.noise(shape) / 8


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(tiles, "_BLOCK_CELLS", 16)


# --- one mesh -----------------------------------------------------------------------------------


def assert_is_the_whole_mesh(heights, cells, max_error):
    made = all_tiles(tiling_of(heights, cells, max_error))
    assert union(made) == union_of_mesh(whole(heights, cells, max_error))


@given(terrains.rasters(largest=40), terrains.tolerances, st.sampled_from(CELLS))
@example(terrains.waves((2, 9)), 0.0, 2)
@example(terrains.noise((9, 2)), 1.0, 2)
@example(terrains.noise((2, 2)), 0.0, 2)
def test_tiles_together_are_the_least_mesh_that_keeps_their_corners(heights, max_error, cells):
    assert_is_the_whole_mesh(heights, cells, max_error)


@pytest.mark.parametrize("holes", terrains.HOLES)
@pytest.mark.parametrize("shape", [(33, 33), (64, 33), (20, 70)], ids=str)
def test_tiles_of_every_terrain_and_hole_are_one_mesh(shape, holes):
    for number, make in enumerate(terrains.GALLERY.values()):
        heights = terrains.pierced(make(shape), terrains.HOLES[holes](shape))
        assert_is_the_whole_mesh(heights, CELLS[number % 4], [0.0, 0.5, 3.0, 20.0][number % 4])


def test_heights_that_float32_cannot_hold_are_kept():
    heights = terrain() + 1e6 / 3.0
    assert_is_the_whole_mesh(heights, 16, 3.0)
    assert heights.dtype == np.float64


def test_the_type_of_the_heights_changes_nothing():
    heights = terrain()
    made = [all_tiles(tiling_of(heights.astype(kind), 8, 2.0)) for kind in ("f4", "f8")]
    assert union(made[0]) == union(made[1])


def test_a_raster_smaller_than_a_tile_is_one_tile():
    heights = terrains.waves((9, 6))
    (tile,) = all_tiles(tiling_of(heights, 1024, 1.0))
    mesh = rtin.coarsen(rtin.Grid(heights), max_error=1.0)
    assert tile.cells == 8
    np.testing.assert_array_equal(tile.triangles, mesh.triangles)
    np.testing.assert_array_equal(tile.heights, mesh.vertices[:, 2])


@given(terrains.rasters(largest=40), terrains.tolerances, st.sampled_from(CELLS))
def test_every_tile_lists_vertices_row_by_row_and_triangles_counter_clockwise(
    heights, max_error, cells
):
    for tile in all_tiles(tiling_of(heights, cells, max_error)):
        order = tile.rows.astype(int) * (tile.cells + 1) + tile.cols
        assert (np.diff(order) > 0).all()
        assert set(tile.triangles.ravel()) == set(range(len(order)))
        a, b, apex = (np.stack([tile.cols, -tile.rows], 1)[tile.triangles[:, i]] for i in range(3))
        assert (np.linalg.det(np.stack([b - a, apex - a], 1).astype(float)) > 0).all()
        assert (((apex - a) * (apex - b)).sum(axis=1) == 0).all()


@given(terrains.rasters(largest=40), terrains.tolerances, st.sampled_from(CELLS))
def test_the_error_of_a_tile_is_what_its_samples_say(heights, max_error, cells):
    for tile in all_tiles(tiling_of(heights, cells, max_error)):
        row, col = tile.row * tile.cells, tile.col * tile.cells
        lattice = ArrayLattice(heights)
        window = lattice.read((row, row + tile.cells + 1), (col, col + tile.cells + 1))
        vertices = np.column_stack([tile.cols, -tile.rows, tile.heights])
        mesh = rtin.TriangleMesh(vertices, tile.triangles)
        assert tile.error == rtin.vertical_error(mesh, rtin.Grid(window)).max <= max_error


# --- where tiles meet ---------------------------------------------------------------------------


@given(terrains.rasters(largest=40), terrains.tolerances, st.sampled_from([4, 8]))
def test_neighbours_share_vertices_heights_and_slopes(heights, max_error, cells):
    seen = {}
    for tile in all_tiles(tiling_of(heights, cells, max_error)):
        values = np.column_stack([tile.heights, tile.slopes]).tolist()
        for place, value in zip(places_of(tile), values, strict=True):
            assert seen.setdefault(place, value) == value


def kept_by(tile, row, col):
    """Positions along a border, (north or south) row or (west or east) column of a tile."""
    places = zip(tile.rows.tolist(), tile.cols.tolist(), strict=True)
    if row is not None:
        return {place[1] for place in places if place[0] == row}
    return {place[0] for place in places if place[1] == col}


def test_no_vertex_hangs_between_two_tiles():
    made = {
        (t.row, t.col): t for t in all_tiles(tiling_of(terrain(holes=terrains.no_holes), 8, 2.0))
    }
    n_shared = 0
    for (row, col), tile in made.items():
        for there, mine, theirs in [
            ((row + 1, col), (tile.cells, None), (0, None)),
            ((row, col + 1), (None, tile.cells), (None, 0)),
        ]:
            if there in made and max(there) < 9:
                assert kept_by(tile, *mine) == kept_by(made[there], *theirs)
                n_shared += 1
    assert n_shared > 100


def test_slopes_are_central_differences_and_one_sided_beside_voids():
    heights = terrains.pierced(terrains.noise((17, 17)), terrains.pond((17, 17)))
    for tile in all_tiles(tiling_of(heights, 4, 0.0)):
        for (row, col), slopes in zip(places_of(tile), tile.slopes.tolist(), strict=True):
            assert slopes == [slope(heights[row], col), -slope(heights[:, col], row)]


def slope(profile, at):
    steps = [profile[at] - profile[at - 1]] if at > 0 else []
    steps += [profile[at + 1] - profile[at]] if at + 1 < len(profile) else []
    steps = [step for step in steps if not np.isnan(step)]
    return sum(steps) / len(steps) if steps else 0.0


def test_slopes_of_a_plane_are_its_own():
    for tile in all_tiles(tiling_of(terrains.tilted((33, 33)), 8, 0.0)):
        assert (tile.slopes == [-1.25, -0.75]).all()


# --- however the work is cut --------------------------------------------------------------------


class Shuffled(Executor):
    """Works off what it is given in another order, here."""

    def submit(self, function, *args):
        future = Future()
        future.set_result(function(*args))
        return future

    def map(self, function, *iterables):
        calls = list(enumerate(zip(*iterables, strict=True)))
        random.Random(len(calls)).shuffle(calls)
        results = {number: function(*call) for number, call in calls}
        return (results[number] for number in range(len(calls)))


@pytest.mark.parametrize("block_cells", [1, 8, 24, 64, 2048])
def test_blocks_of_any_size_settle_the_same_borders(monkeypatch, block_cells):
    tiling = tiling_of(rough(), 8, 6.0)
    one_block = settle_borders(tiling)
    monkeypatch.setattr(tiles, "_BLOCK_CELLS", block_cells)
    monkeypatch.setattr(tiles, "_MOST_TILES", 5)
    assert tiles._block_side(tiling) == min(max(1, block_cells // 8), 5)
    assert settle_borders(tiling) == one_block


def test_executors_settle_the_same_borders(small_blocks):
    tiling = tiling_of(rough(), 8, 6.0)
    here = settle_borders(tiling)
    assert settle_borders(tiling, executor=Shuffled()) == here
    with ThreadPoolExecutor(3) as threads:
        assert settle_borders(tiling, executor=threads) == here


def test_processes_make_the_same_tiles():
    tiling = tiling_of(terrain((300, 200)), 16, 1.5)
    here = all_tiles(tiling)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        borders = settle_borders(tiling, executor=processes).borders
        places = tiling.tiles()
        halves = processes.map(made_there, [tiling] * 2, [places[::2], places[1::2]], [borders] * 2)
        there = [tile for half in halves for tile in half]
    assert union(there) == union(here)
    assert total(there) == total(here)


def made_there(tiling, places, borders):
    return list(make_tiles(tiling, places, borders))


@pytest.mark.parametrize("n_threads", ["1", "2"])
def test_number_of_threads_changes_no_byte(monkeypatch, n_threads):
    tiling = tiling_of(terrain((600, 600)), 512, 1.5)
    made = all_tiles(tiling)
    monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
    assert [same_bytes(*pair) for pair in zip(all_tiles(tiling), made, strict=True)] == [True] * 4


def same_bytes(one, other):
    names = ("rows", "cols", "heights", "slopes", "triangles")
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in names)


def test_tiles_are_the_same_in_any_order_and_alone():
    tiling = tiling_of(rough(), 8, 6.0)
    borders = settle_borders(tiling).borders
    together = {(t.row, t.col): t for t in make_tiles(tiling, tiling.tiles(), borders)}
    places = list(together)
    random.Random(1).shuffle(places)
    alone = {place: next(make_tiles(tiling, [place], borders)) for place in places}
    assert all(same_bytes(alone[place], together[place]) for place in places)


def test_a_border_next_to_a_block_is_settled_again(small_blocks):
    """Without the exchange between blocks, their borders would not be those of the whole mesh."""
    tiling = tiling_of(rough(), 8, 6.0)
    right = settle_borders(tiling).borders
    alone = {}
    for block, places in tiles._by_block(tiling, tiling.tiles()).items():
        for edge, marks in tiles.settle_block(tiling, block, places, {}).borders.items():
            alone[edge] = alone.get(edge, 0) | marks
    assert alone != right


@pytest.mark.parametrize("block_cells", [8, 16, 2048])
def test_tells_every_tile_once_and_again_what_is_settled_again(monkeypatch, block_cells):
    monkeypatch.setattr(tiles, "_BLOCK_CELLS", block_cells)
    tiling = tiling_of(rough(), 8, 6.0)
    told = []
    settle_borders(tiling, tell=lambda done, in_sight: told.append((done, in_sight)))
    done, in_sight = zip(*told, strict=True)
    assert list(done) == sorted(set(done))
    assert all(d <= s for d, s in told)
    assert in_sight[0] == len(tiling.tiles())
    assert done[-1] == in_sight[-1]
    assert (done[-1] > len(tiling.tiles())) == (block_cells < 2048)


# --- the checksum -------------------------------------------------------------------------------


def naive_checksum(triangles, heights):
    """The sum of hashes of triangles (a, b, apex), in whole numbers."""

    def mixed(value):
        value = (value + 0x9E3779B97F4A7C15) % 2**64
        value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) % 2**64
        return value ^ (value >> 31)

    result = 0
    for triangle in triangles:
        value = 0
        for row, col in triangle:
            bits = int.from_bytes(np.float64(heights[row, col]).tobytes(), "little")
            value = mixed((value + mixed(mixed(row * 2**32 + col) ^ bits)) % 2**64)
        result += value
    return result % 2**64


def checksum_of_mesh(mesh):
    x, y, z = mesh.vertices.T
    return checksum(-y.astype(int), x.astype(int), z, mesh.triangles)


@given(terrains.rasters(), terrains.tolerances)
def test_checksum_is_its_definition(heights, max_error):
    mesh = rtin.coarsen(rtin.Grid(heights), max_error=max_error)
    _, triangles = union_of_mesh(mesh)
    assert checksum_of_mesh(mesh) == naive_checksum(triangles, heights)


@given(terrains.rasters(largest=40), terrains.tolerances, st.sampled_from(CELLS))
def test_checksums_of_tiles_add_up_to_that_of_the_mesh(heights, max_error, cells):
    made = all_tiles(tiling_of(heights, cells, max_error))
    assert total(made) == checksum_of_mesh(whole(heights, cells, max_error))


def test_checksum_tells_heights_triangles_and_places_apart():
    mesh = rtin.coarsen(rtin.Grid(terrains.noise((9, 9))), max_error=0.0)
    x, y, z = mesh.vertices.T
    rows, cols = -y.astype(int), x.astype(int)
    higher = z.copy()
    higher[17] = np.nextafter(z[17], np.inf)
    sums = {
        checksum(rows, cols, z, mesh.triangles),
        checksum(rows, cols, higher, mesh.triangles),
        checksum(rows + 1, cols, z, mesh.triangles),
        checksum(cols, rows, z, mesh.triangles),
        checksum(rows, cols, z, mesh.triangles[1:]),
        checksum(rows, cols, z, mesh.triangles[:, ::-1]),
    }
    assert len(sums) == 6


# --- round the world ----------------------------------------------------------------------------


def by_coarsen(tiling):
    """Vertices of each tile: every tile by ``coarsen`` alone, again and again with what its
    neighbours keep, until nothing changes."""
    cells, marked, vertices = tiling.cells, set(), {}
    along = np.arange(cells + 1)
    while True:
        before = len(marked)
        for row, col in tiling.tiles():
            rows, cols = row * cells + along, col * cells + along
            if tiling.lattice.period is not None:
                cols = cols % tiling.lattice.period
            heights = tiling.lattice.read((row * cells, row * cells + cells + 1), span(col, cells))
            keep = np.array([[(r, c) in marked for c in cols.tolist()] for r in rows.tolist()])
            turn = slice(None, None, -1 if (row + col) % 2 else 1)
            grid = rtin.Grid(heights[:, turn])
            mesh = rtin.coarsen(grid, max_error=tiling.max_error, keep=keep[:, turn])
            found = {(r, along[turn][c]) for r, c in union_of_mesh(mesh)[0]}
            border = {place for place in found if {0, cells} & set(place)}
            marked |= {(int(rows[r]), int(cols[c])) for r, c in border}
            vertices[row, col] = found
        if len(marked) == before:
            return vertices


def span(tile, cells):
    return tile * cells, (tile + 1) * cells + 1


@pytest.mark.parametrize("n_cols", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("block_cells", [16, 2048])
def test_round_the_world_the_last_tile_is_the_firsts_neighbour(
    monkeypatch, n_cols, block_cells, seed
):
    monkeypatch.setattr(tiles, "_BLOCK_CELLS", block_cells)
    heights = terrains.noise((33, 16 * n_cols), seed) / 8
    tiling = Tiling(ArrayLattice(heights, period=16 * n_cols), 16, 6.0, (2, n_cols))
    expected = by_coarsen(tiling)
    made = {
        (t.row, t.col): set(zip(t.rows.tolist(), t.cols.tolist(), strict=True))
        for t in all_tiles(tiling)
    }
    assert made == expected
    assert any(0 < len(vertices) < 17**2 for vertices in made.values())


@pytest.mark.parametrize("n_cols", [2, 4])
def test_a_lattice_round_the_world_is_the_middle_of_many(n_cols):
    heights = terrains.noise((25, n_cols * 8), seed=n_cols) / 8
    once = Tiling(ArrayLattice(heights, period=n_cols * 8), 8, 6.0, (3, n_cols))
    flat = np.tile(heights, 13)
    many = Tiling(ArrayLattice(np.column_stack([flat, flat[:, 0]])), 8, 6.0, (3, 13 * n_cols))
    places = [(row, 6 * n_cols + col) for row, col in once.tiles()]
    expected = list(make_tiles(many, places, settle_borders(many).borders))
    made = all_tiles(once)
    assert len(made) == 3 * n_cols
    assert all(same_bytes(*pair) for pair in zip(made, expected, strict=True))


def test_a_lattice_across_the_antimeridian_is_the_same_lattice_elsewhere():
    heights = terrains.noise((17, 25)) / 8
    here = Tiling(ArrayLattice(heights, period=64), 8, 6.0, (2, 8))
    across = Tiling(ArrayLattice(heights, period=64, first=(0, 48)), 8, 6.0, (2, 8))
    assert {col for _, col in across.tiles()} == {5, 6, 7, 0, 1}
    assert {col for _, col in here.tiles()} == {7, 0, 1, 2, 3}
    elsewhere = {(t.row, (t.col + 6) % 8): t for t in all_tiles(here)}
    made = {(t.row, t.col): t for t in all_tiles(across)}
    assert made.keys() == elsewhere.keys()
    assert all(same_bytes(tile, elsewhere[place]) for place, tile in made.items())


# --- voids and what fills them ------------------------------------------------------------------


def everywhere(tiling):
    """All places of a tiling, with heights or without."""
    return list(np.ndindex(tiling.shape))


def filled(tiling):
    """The heights of all nodes of a tiling, voids at its fill."""
    n_rows, n_cols = tiling.shape
    heights = tiling.lattice.read((0, n_rows * tiling.cells + 1), (0, n_cols * tiling.cells + 1))
    return np.where(np.isnan(heights), tiling.fill, heights)


def with_fill(heights, cells, max_error, fill):
    tiling = tiling_of(heights, cells, max_error)
    return Tiling(tiling.lattice, tiling.cells, max_error, tiling.shape, fill)


@given(terrains.rasters(largest=40), terrains.tolerances, st.sampled_from(CELLS))
def test_a_fill_makes_the_mesh_of_the_filled_raster(heights, max_error, cells):
    tiling = with_fill(heights, cells, max_error, -3.0)
    borders = settle_borders(tiling).borders
    made = list(make_tiles(tiling, everywhere(tiling), borders))
    assert len(made) == len(everywhere(tiling))
    assert union(made) == union_of_mesh(whole(filled(tiling), tiling.cells, max_error))


def two_lands():
    """Rough land in the west and in the east, and a sea of a tile's width between them."""
    heights = terrains.noise((49, 49)) / 8
    heights[:, 16:33] = np.nan
    return heights


def test_a_tile_without_heights_passes_on_what_its_neighbours_keep(monkeypatch):
    tiling = with_fill(two_lands(), 16, 6.0, 0.0)
    expected = union_of_mesh(whole(filled(tiling), 16, 6.0))
    borders = settle_borders(tiling).borders
    assert union(make_tiles(tiling, everywhere(tiling), borders)) == expected
    monkeypatch.setattr("rtin._kernels.coarsening.close_all", lambda kept, work: None)
    deaf = settle_borders(tiling).borders
    monkeypatch.undo()
    assert union(make_tiles(tiling, everywhere(tiling), deaf)) != expected


def test_tiles_without_heights_are_left_out_unless_they_are_filled():
    heights = np.full((17, 49), np.nan)
    heights[2:9, 3:7] = 1.0
    open_tiling = Tiling(ArrayLattice(heights), 16, 1.0, (1, 3))
    assert [(t.row, t.col) for t in all_tiles(open_tiling)] == [(0, 0)]
    assert settle_borders(open_tiling).places == {(0, 0)}
    _, sea, far = all_tiles(Tiling(ArrayLattice(heights), 16, 1.0, (1, 3), 7.5))
    assert set(sea.heights) == {7.5}
    assert far.heights.tolist() == [7.5] * 4


def test_where_there_is_nothing_nothing_is_read():
    heights = np.full((1025, 1025), np.nan)
    heights[500:505, 500:505] = 1.0
    tiling = tiling_of(heights, 16, 1.0)
    lattice = CountingLattice(heights[496:513, 496:513], first=(496, 496))
    tiling = Tiling(lattice, 16, 1.0, tiling.shape)
    settle_borders(tiling)
    assert len(lattice.windows) < 10


class CountingLattice(ArrayLattice):
    """Remembers what was read."""

    windows = ()

    def read(self, rows, cols):
        object.__setattr__(self, "windows", (*self.windows, (rows, cols)))
        return super().read(rows, cols)


def test_heights_without_a_triangle_make_no_tile():
    heights = np.full((9, 9), np.nan)
    heights[::2, ::2] = 1.0
    assert all_tiles(tiling_of(heights, 4, 1.0)) == []


def test_tells_where_heights_are_and_how_far_apart():
    heights = np.full((9, 17), np.nan)
    heights[1:3, 1:3] = [[1.0, 2.0], [5.0, 3.0]]
    heights[4, 8] = 100.0
    settled = settle_borders(tiling_of(heights, 4, 1.0))
    assert settled.places == {(0, 0), (0, 1), (1, 1), (0, 2), (1, 2)}
    assert settled.largest_range == 4.0


# --- levels -------------------------------------------------------------------------------------


@given(terrains.rasters(largest=40, holes=False), st.sampled_from([0.0, 0.5, 2.0, 7.0]))
def test_meshes_of_every_second_node_are_nested(heights, max_error):
    assume(max(heights.shape) > 4)
    size = 4 * tiles.lattice_size(heights.shape)
    levels = []
    for step, factor in ((1, 1.0), (2, 1.0), (4, 2.5)):
        thin = decimated(heights, step)
        if min(thin.shape) < 2:
            return
        n_tiles = size // 4 // step
        tiling = Tiling(ArrayLattice(thin), 4, factor * max_error, (n_tiles, n_tiles))
        places, _ = union(all_tiles(tiling))
        levels.append({(row * step, col * step) for row, col in places})
    finest, middle, coarsest = levels
    assert coarsest <= middle <= finest


# --- the door -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"cells": 12}, ValueError, "cells must be a power of two from 2 to 16384, got 12"),
        ({"cells": 1}, ValueError, "cells must be a power of two from 2 to 16384, got 1"),
        ({"cells": 0}, ValueError, "cells must be a power of two from 2 to 16384, got 0"),
        ({"cells": -4}, ValueError, "cells must be a power of two from 2 to 16384, got -4"),
        ({"cells": 2**15}, ValueError, "from 2 to 16384, got 32768"),
        ({"cells": 8.0}, TypeError, "cells must be a whole number, got 8.0"),
        ({"cells": True}, TypeError, "cells must be a whole number, got True"),
        ({"max_error": -1.0}, ValueError, "max_error must be zero or more"),
        ({"max_error": np.nan}, ValueError, "max_error must be zero or more"),
        ({"max_error": "5"}, TypeError, "max_error must be a number, got '5'"),
        ({"max_error": np.ones(3)}, TypeError, "max_error must be a number"),
        ({"shape": (0, 3)}, ValueError, r"shape must be two whole numbers from 1 on, got \(0, 3\)"),
        ({"shape": (3,)}, ValueError, "shape must be two whole numbers"),
        ({"shape": 3}, ValueError, "shape must be two whole numbers"),
        ({"fill": np.nan}, ValueError, "fill must be None or a finite height, got nan"),
        ({"fill": "sea"}, TypeError, "fill must be a number, got 'sea'"),
        ({"lattice": ArrayLattice(np.ones((9, 9)), period=9)}, ValueError, "period of 9 columns"),
    ],
)
def test_refuses_what_is_no_tiling(changes, error, message):
    options = {"lattice": ArrayLattice(np.ones((9, 9))), "cells": 4, "max_error": 1.0}
    with pytest.raises(error, match=message) as raised:
        Tiling(**{**options, "shape": (2, 2), **changes})
    assert "\n" not in str(raised.value)


def test_refuses_a_raster_of_one_row():
    with pytest.raises(ValueError, match="at least 2 rows and 2 columns, got 1 × 9"):
        tiling_of(np.ones((1, 9)), 4, 1.0)


def test_refuses_cells_that_are_no_power_of_two_even_where_the_raster_is_smaller():
    with pytest.raises(ValueError, match="cells must be a power of two"):
        tiling_of(np.ones((9, 9)), 100, 1.0)
