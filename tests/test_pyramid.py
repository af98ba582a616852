"""Pyramids: nested zooms, the same heights at the same nodes, whoever settles them."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from errno import ENOSPC

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

from lattices import ArrayLattice, places_of, total
from rtin import pyramid
from rtin._decimated import DecimatedLattice, Recording
from rtin.pyramid import Plan, geometric_error, prepare, shares, tolerances
from rtin.schemes import SCHEMES

CELLS, ROOTS, LAST = 16, 2, 3
PERIOD = CELLS * ROOTS << LAST


def rough(n_rows, n_cols, *, dtype=np.float32, voids=0.0, seed=0):
    generator = np.random.default_rng(seed)
    heights = np.cumsum(np.cumsum(generator.normal(size=(n_rows, n_cols)), axis=0), axis=1)
    heights *= 1000.0 / abs(heights).max()
    heights[generator.random(heights.shape) < voids] = np.nan
    return heights.astype(dtype)


def across_the_seam(**options):
    """A lattice that goes over the end of its columns; rows and columns start oddly."""
    return ArrayLattice(rough(75, 101, **options), PERIOD, first=(21, PERIOD - 37))


def plan_of(lattice, last_error=4.0, first=0, **options):
    fill = options.pop("fill", None)
    wanted = tolerances(first, LAST, [last_error], geometric_error)
    return Plan(lattice, CELLS, ROOTS, wanted, fill, **options)


def tiles_of(levels):
    return {zoom: list(level.make(sorted(level.available))) for zoom, level in levels.items()}


# --- tolerances ---------------------------------------------------------------------------------


def test_the_error_of_a_zoom_is_what_cesium_takes_it_for():
    # CesiumJS: 6378137 · 2π · 0.25 / (65 · 2) metres for the geographic scheme.
    assert geometric_error(SCHEMES["geographic"], 0) == pytest.approx(77067.34, abs=0.01)
    assert geometric_error(SCHEMES["geographic"], 5) == pytest.approx(77067.34 / 32, abs=0.001)
    assert geometric_error(SCHEMES["mercator"], 1) == geometric_error(SCHEMES["geographic"], 0)


def test_tolerances_are_default_or_doubled_or_one_for_each_zoom():
    assert tolerances(2, 4, None, float) == {2: 2.0, 3: 3.0, 4: 4.0}
    assert tolerances(2, 4, [], float) == {2: 2.0, 3: 3.0, 4: 4.0}
    assert tolerances(2, 4, [1.5], float) == {2: 6.0, 3: 3.0, 4: 1.5}
    assert tolerances(2, 4, [9.0, 9.0, 1.0], float) == {2: 9.0, 3: 9.0, 4: 1.0}
    assert tolerances(5, 5, [3.0], float) == {5: 3.0}


@pytest.mark.parametrize(
    ("given", "message"),
    [([1.0, 2.0, 3.0, 4.0], "3 zooms 2 to 4, got 4"), ([1.0, 2.0, 0.5], "must not grow")],
)
def test_tolerances_that_fit_no_zooms_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        tolerances(2, 4, given, float)


# --- levels -------------------------------------------------------------------------------------


@pytest.mark.parametrize("fill", [None, 0.0])
@pytest.mark.parametrize("voids", [0.0, 0.02])
def test_vertices_of_a_parent_are_vertices_of_its_children(tmp_path, fill, voids):
    made = tiles_of(prepare(plan_of(across_the_seam(voids=voids), fill=fill), tmp_path))
    for zoom in range(LAST):
        finer = {places: tile for tile in made[zoom + 1] for places in [(tile.row, tile.col)]}
        known = {place for tile in finer.values() for place in places_of(tile)}
        n_looked_at = 0
        for tile in made[zoom]:
            for row, col in places_of(tile):
                if lies_in_all(finer, 2 * row, 2 * col, zoom + 1):
                    assert (2 * row, 2 * col) in known
                    n_looked_at += 1
        assert n_looked_at > 20 * (zoom + 1)


def lies_in_all(tiles, row, col, zoom):
    """Whether a node lies within or on the border of a tile that there is."""
    return (
        any((row // CELLS, c // CELLS) in tiles for c in (col, col - 1))
        or (
            (row - 1) // CELLS,
            col // CELLS,
        )
        in tiles
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_heights_of_all_zooms_are_those_of_the_finest(tmp_path, dtype):
    lattice = across_the_seam(dtype=dtype, voids=0.1)
    levels = prepare(plan_of(lattice), tmp_path)
    for zoom, level in levels.items():
        step = 2 ** (LAST - zoom)
        heights = level.tiling.lattice.read((-1, CELLS << zoom), (-3, 4 + (2 * CELLS << zoom)))
        rows = np.arange(-step, step * (CELLS << zoom))
        expected = lattice.read(
            (rows[0], rows[-1] + 1), (-3 * step, step * (4 + (2 * CELLS << zoom)))
        )
        assert heights.dtype == dtype
        assert np.isfinite(heights).any()
        np.testing.assert_array_equal(heights, expected[::step, ::step])


def test_every_node_is_within_the_tolerance_less_the_margin(tmp_path):
    plan = plan_of(across_the_seam(), margin=0.25)
    levels = prepare(plan, tmp_path)
    assert all(level.tiling.max_error == 0.75 * plan.tolerances[z] for z, level in levels.items())
    for zoom, tiles in tiles_of(levels).items():
        assert 0.0 < max(tile.error for tile in tiles) <= 0.75 * plan.tolerances[zoom]


def test_parents_of_tiles_are_there_where_voids_are_filled(tmp_path):
    heights = np.full((40, 40), np.nan, np.float32)
    heights[17, 19] = 5.0  # no node of coarser zooms
    lattice = ArrayLattice(heights, PERIOD)
    filled = prepare(plan_of(lattice, fill=0.0), tmp_path / "filled")
    assert [level.available for level in filled.values()] == [
        {(0, 0)}, {(0, 0)}, {(0, 0)}, {(1, 1)},
    ]  # fmt: skip
    assert all(len(tiles) == 1 for tiles in tiles_of(filled).values())
    empty = prepare(plan_of(lattice), tmp_path / "open")
    assert [level.available for level in empty.values()] == [set(), set(), set(), {(1, 1)}]
    assert not any(tiles_of(empty).values())


def test_only_tiles_that_are_available_are_made_and_others_can_be_added(tmp_path):
    level = prepare(plan_of(across_the_seam(), fill=7.0), tmp_path)[1]
    assert (1, 1) not in level.available
    assert not list(level.make([(1, 1)]))
    (tile,) = level.with_tiles([(1, 1)]).make([(1, 1)])
    assert set(tile.heights.tolist()) == {7.0}


def test_cells_are_not_larger_than_asked(tmp_path):
    largest = {zoom: max(2, CELLS >> zoom) for zoom in range(LAST + 1)}
    flat = ArrayLattice(np.zeros(((CELLS << LAST) + 1, PERIOD), np.float32), PERIOD)
    made = tiles_of(prepare(plan_of(flat, largest_cells=largest), tmp_path))
    for zoom, tiles in made.items():
        for tile in tiles[:3]:
            corners = np.stack([tile.rows, tile.cols], axis=-1)[tile.triangles].astype(int)
            assert np.ptp(corners, axis=1).max() == largest[zoom]


def test_zooms_may_begin_and_end_anywhere(tmp_path):
    whole = tiles_of(prepare(plan_of(across_the_seam()), tmp_path / "whole"))
    part = tiles_of(prepare(plan_of(across_the_seam(), first=2), tmp_path / "part"))
    assert sorted(part) == [2, 3]
    assert all(total(part[zoom]) == total(whole[zoom]) for zoom in part)


def test_what_is_settled_is_taken_from_the_folder(tmp_path, monkeypatch):
    plan = plan_of(across_the_seam(voids=0.01), fill=0.0)
    first = prepare(plan, tmp_path)
    monkeypatch.setattr(pyramid, "settle_borders", None)
    again = prepare(plan, tmp_path)
    for zoom, level in first.items():
        assert again[zoom].settled == level.settled
        assert again[zoom].available == level.available
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("first_gone", range(LAST + 1))
def test_a_run_that_ended_between_zooms_goes_on(tmp_path, first_gone):
    plan = plan_of(across_the_seam(), fill=0.0)
    first = prepare(plan, tmp_path)
    for zoom in range(first_gone + 1):  # coarser ones come later
        (tmp_path / f"settled-{zoom}.npz").unlink()
    again = prepare(plan, tmp_path)
    assert all(again[zoom].settled == level.settled for zoom, level in first.items())


def test_an_executor_changes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("rtin.tiles._BLOCK_CELLS", 2 * CELLS)
    plan = plan_of(across_the_seam(voids=0.01))
    alone = prepare(plan, tmp_path / "alone")
    with ThreadPoolExecutor(3) as executor:
        together = prepare(plan, tmp_path / "together", executor=executor)
    assert {zoom: level.settled for zoom, level in alone.items()} == {
        zoom: level.settled for zoom, level in together.items()
    }
    for zoom in range(LAST):
        name = f"heights-{zoom}"
        assert (tmp_path / "alone" / name).read_bytes() == (
            tmp_path / "together" / name
        ).read_bytes()


def test_shares_of_the_work_rise_to_one(tmp_path):
    heard = []
    plan = plan_of(across_the_seam())
    prepare(plan, tmp_path, tell=shares(plan, heard.append))
    assert heard == sorted(heard)
    assert heard[0] > 0.0
    assert heard[-1] == pytest.approx(1.0)


# --- decimated lattices -------------------------------------------------------------------------


@st.composite
def recorded(draw):
    """A lattice, a step, windows read through a recording, and one to look at."""
    period = draw(st.sampled_from([None, 32, 64]))
    n_rows, n_cols = draw(st.integers(1, 20)), draw(st.integers(1, period or 40))
    first = draw(st.integers(0, 9)), draw(st.integers(0, (period or 10) - 1))
    dtype = draw(st.sampled_from([np.float32, np.float64]))
    heights = rough(n_rows, n_cols, dtype=dtype, voids=0.2, seed=draw(st.integers(0, 9)))
    lattice = ArrayLattice(heights, period, first=first)
    windows = draw(st.lists(st.tuples(spans(-3, 32), spans(-40, 80)), max_size=4))
    return lattice, draw(st.sampled_from([1, 2, 4, 8])), windows


def spans(first, end):
    return st.tuples(st.integers(first, end), st.integers(1, 30)).map(lambda s: (s[0], sum(s)))


@given(recorded(), st.tuples(spans(-5, 16), spans(-30, 70)))
def test_a_decimated_lattice_holds_what_was_read_and_nothing_else(tmp_path_factory, case, window):
    lattice, step, windows = case
    path = tmp_path_factory.mktemp("decimated") / "heights"
    decimated = DecimatedLattice.of(lattice, step, path)
    recording = Recording(lattice, (decimated,))
    for rows, cols in windows:
        np.testing.assert_array_equal(recording.read(rows, cols), lattice.read(rows, cols))
    rows, cols = (step * np.arange(*span) for span in window)
    seen = np.zeros((len(rows), len(cols)), bool)
    for (top, bottom), (left, right) in windows:
        beyond = cols - left if lattice.period is None else (cols - left) % lattice.period
        seen |= ((top <= rows) & (rows < bottom))[:, None] & (beyond >= 0) & (beyond < right - left)
    whole = lattice.read((rows[0], rows[-1] + 1), (cols[0], cols[-1] + 1))
    expected = np.where(seen, whole[::step, ::step], np.nan)
    assert decimated.read(*window).dtype == lattice.heights.dtype
    np.testing.assert_array_equal(decimated.read(*window), expected)


def test_a_decimated_lattice_says_where_it_is_and_travels(tmp_path):
    transform = Affine(0.5, 0.0, -180.0, 0.0, -0.25, 90.0)
    lattice = ArrayLattice(rough(9, 11), 64, transform, "EPSG:4326", first=(3, 60))
    decimated = DecimatedLattice.of(lattice, 4, tmp_path / "heights")
    assert (decimated.rows, decimated.cols, decimated.period) == ((1, 3), (15, 18), 16)
    assert decimated.transform @ (2, 3) == lattice.transform @ (8, 12)
    recording = Recording(lattice, (decimated,))
    for name in ("rows", "cols", "period", "transform", "crs"):
        assert getattr(recording, name) == getattr(lattice, name)
    recording.read((0, 20), (58, 80))
    read = decimated.read((0, 4), (14, 19))
    assert np.isfinite(read).sum() == 2 * 3
    np.testing.assert_array_equal(
        pickle.loads(pickle.dumps(decimated)).read((0, 4), (14, 19)), read
    )
    # Made once more it is found as it is.
    found = DecimatedLattice.of(lattice, 4, tmp_path / "heights")
    np.testing.assert_array_equal(found.read((0, 4), (14, 19)), read)


def test_what_was_never_read_takes_no_space(tmp_path):
    heights = np.zeros((4096, 4096), np.float32)
    heights[1000:3000] = np.nan  # what is void takes none either
    lattice = ArrayLattice(heights)
    decimated = DecimatedLattice.of(lattice, 2, tmp_path / "heights")
    Recording(lattice, (decimated,)).read((64, 128), (0, 4096))
    Recording(lattice, (decimated,)).read((1000, 3000), (0, 4096))
    state = decimated.path.stat()
    assert state.st_size == 4 * 2048**2
    assert 512 * state.st_blocks < state.st_size / 8


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path, monkeypatch):
    lattice = ArrayLattice(rough(20, 20))
    decimated = DecimatedLattice.of(lattice, 2, tmp_path / "heights")

    def fail(*_):
        raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr("rtin._decimated._write", fail)
    with pytest.raises(OSError, match=r"cannot write .*heights: No space left on device"):
        Recording(lattice, (decimated,)).read((0, 20), (0, 20))
