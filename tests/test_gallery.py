"""The gallery's examples run, and what they model keeps its laws.

Building the docs runs all examples. Those that draw films or ask other libraries take longer and
are left to that; of them the models alone are tested here, as they stand in the first cell.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rtin

plt = pytest.importorskip("matplotlib.pyplot")
pytest.importorskip("scipy")

GALLERY = Path(__file__).parent.parent / "docs" / "gallery"
EXAMPLES = {path.stem.removeprefix("plot_"): path for path in sorted(GALLERY.rglob("plot_*.py"))}
BY_THE_DOCS_ONLY = {
    "crater", "flight", "landslide", "rising_water", "simplifiers", "surface_distance",
    "three_dimensions", "tiles",
}  # fmt: skip


def source_of(name):
    return EXAMPLES[name].read_text(encoding="utf-8")


def models_of(name):
    """Return what the first cell of an example defines."""
    namespace = {}
    first_cell = source_of(name).split("\n# %%\n")[0]
    exec(compile(first_cell, str(EXAMPLES[name]), "exec"), namespace)
    return namespace


def looks(figure):
    """Return the standard deviation of a figure's shades, 0 to 255."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[:, :, :3].std()


@pytest.fixture
def figures(monkeypatch):
    """Close what an example leaves open; show nothing."""
    monkeypatch.setattr(plt, "show", lambda: None)
    plt.switch_backend("agg")
    with mpl.rc_context({"figure.dpi": 50}):
        yield lambda: [plt.figure(number) for number in plt.get_fignums()]
    plt.close("all")


def test_there_are_examples_of_every_kind():
    assert len(EXAMPLES) >= 20
    assert set(EXAMPLES) > BY_THE_DOCS_ONLY


@pytest.mark.parametrize("name", sorted(set(EXAMPLES) - BY_THE_DOCS_ONLY))
def test_an_example_runs_and_draws(name, figures):
    pytest.importorskip("skfem") if name == "finite_elements" else None
    namespace = {}
    exec(compile(source_of(name), str(EXAMPLES[name]), "exec"), namespace)
    drawn = figures()
    assert drawn
    assert min(looks(figure) for figure in drawn) > 10.0


# --- craters ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def crater():
    return models_of("crater")


def assert_as_afresh(lod):
    """Check that a hierarchy that was updated gives the meshes of a new one."""
    afresh = rtin.LevelOfDetail(lod.grid)
    for max_error in (0.0, 0.5, 3.0):
        one, other = lod.mesh(max_error=max_error), afresh.mesh(max_error=max_error)
        assert one.vertices.tobytes() == other.vertices.tobytes()
        assert one.triangles.tobytes() == other.triangles.tobytes()


@given(radius=st.integers(2, 40), depth=st.floats(0.1, 100.0))
def test_a_crater_throws_out_what_it_digs(crater, radius, depth):
    change = crater["crater"](radius, depth)
    assert abs(change.sum()) <= 1e-12 * np.abs(change).sum()
    assert change.min() == -depth == change[len(change) // 2, len(change) // 2]


def test_the_rim_of_a_crater_is_as_high_as_its_volume_asks(crater):
    # Per radius squared and 2 pi: the bowl takes depth / 4; the blanket has 1 / 4 inside the rim,
    # and (1 - q) - q³ (q⁻² - 1) / 2 beyond, for q = 1 / 4.
    expected = 0.25 / (0.25 + 0.75 - 15 / 128)
    assert crater["crater"](200, 1.0).max() == pytest.approx(expected, rel=0.02)


@given(row=st.integers(0, 64), col=st.integers(0, 80), radius=st.integers(2, 12))
def test_an_impact_changes_its_patch_alone_and_all_of_it(crater, row, col, radius):
    before = np.random.default_rng(1).normal(size=(65, 81)).cumsum(axis=0).astype(np.float32)
    lod = rtin.LevelOfDetail(rtin.Grid(before))
    patch = crater["strike"](lod, row, col, crater["crater"](radius, 5.0))
    after = lod.grid.heights
    assert after[row, col] == pytest.approx(before[row, col] - 5.0, abs=1e-5)
    outside = np.ones(before.shape, bool)
    outside[patch] = False
    assert np.array_equal(after[outside], before[outside])
    assert_as_afresh(lod)


# --- the landslide ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def landslide():
    return models_of("landslide")


@pytest.fixture(scope="module")
def slide(landslide):
    """Return the ground, and thicknesses of mud from moment to moment."""
    ground, mud = landslide["valley"](97), [landslide["release"](97)]
    for _ in range(300):
        mud.append(landslide["flow"](ground, mud[-1], 0.05))
    return ground, mud


def test_mud_is_neither_lost_nor_made(slide):
    _, mud = slide
    totals = np.array([layer.sum() for layer in mud])
    assert totals == pytest.approx(totals[0], rel=1e-12)
    assert min(layer.min() for layer in mud) >= 0.0


def test_mud_only_falls(slide):
    ground, mud = slide
    energies = np.array([np.sum(layer * (ground + layer / 2.0)) for layer in mud])
    assert (np.diff(energies) <= 0.0).all()
    assert energies[-1] < 0.8 * energies[0]


@given(seed=st.integers(0, 1000), seconds=st.floats(0.01, 100.0), roughness=st.floats(1.0, 60.0))
def test_steps_of_any_length_leave_mud_everywhere_and_only_lower_it(
    landslide, seed, seconds, roughness
):
    # Of what is in a cell 4 / 5 go at most. A face moves m <= drop / 8, and changes the energy by
    # no more than -m * drop + 4 * m**2 < 0.
    ground, mud = np.random.default_rng(seed).uniform(0.0, [[[roughness]], [[60.0]]], (2, 12, 15))
    mud[:, 7:] = 60.0 + mud[:, 7:] / 20.0 - ground[:, 7:]  # an almost level half
    after = landslide["flow"](ground, mud, seconds)
    assert (after >= 0.19 * mud).all()
    assert after.sum() == pytest.approx(mud.sum(), rel=1e-12)
    energies = [np.sum(layer * (ground + layer / 2.0)) for layer in (mud, after)]
    assert energies[1] < energies[0]


def test_mud_goes_down_the_slope(slide):
    rows = np.arange(97)
    places = [layer.sum(axis=1) @ rows / layer.sum() for layer in slide[1][::50]]
    assert (np.diff(places) > 0.5).all()


def test_mud_rests_where_friction_holds_it(landslide):
    ground = 0.9 * landslide["FRICTION"] * landslide["CELL"] * np.mgrid[0:40, 0:50][0]
    mud = np.full(ground.shape, 3.0)
    assert np.array_equal(landslide["flow"](ground, mud, 0.05), mud)


def test_mud_does_not_know_rows_from_columns(landslide, slide):
    ground, mud = slide
    turned = landslide["flow"](ground.T, mud[40].T, 0.05).T
    assert turned == pytest.approx(mud[41], abs=1e-12)


def test_the_ground_under_a_landslide_is_renewed_as_if_afresh(landslide, slide):
    ground, mud = slide
    drawn = mud[0].copy()
    lod = rtin.LevelOfDetail(rtin.Grid(ground + drawn))
    for layer in mud[60::60]:
        landslide["settle"](lod, ground, drawn, layer)
        assert lod.grid.heights == pytest.approx(ground + layer, abs=2e-3)
        assert_as_afresh(lod)


# --- rising water -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def water():
    return models_of("rising_water")


@pytest.fixture(scope="module")
def basin():
    """Return ground with a lake to be, whose deepest place is known, and a pit beside it."""
    rows, cols = np.mgrid[0:65, 0:97]
    ground = 0.02 * ((rows - 30) ** 2 + (cols - 35) ** 2) + 3.0 * np.sin(rows / 4) * np.cos(
        cols / 5
    )
    ground += 40.0 * np.exp(-(((cols - 72) / 4.0) ** 2))
    ground[20:30, 85:92] = -30.0
    return ground, np.unravel_index(ground[:, :70].argmin(), (65, 70))


def test_a_lake_is_flat_and_connected_and_leaves_pits_beyond_its_shore_dry(water, basin):
    ground, source = basin
    lod = rtin.LevelOfDetail(rtin.Grid(ground))
    wet = water["rise"](lod, ground, 10.0, source)
    surface = lod.grid.heights
    assert wet[source]
    assert not wet[20:30, 85:92].any()
    assert (surface[wet] == 10.0).all()
    assert np.array_equal(surface[~wet], ground[~wet])
    beside = np.zeros_like(wet)
    beside[1:] |= wet[:-1]
    beside[:-1] |= wet[1:]
    beside[:, 1:] |= wet[:, :-1]
    beside[:, :-1] |= wet[:, 1:]
    assert (ground[beside & ~wet] >= 10.0).all()


def test_a_rising_lake_gains_its_area_times_the_rise(water, basin):
    ground, source = basin
    levels = np.arange(0.0, 20.0, 0.5)
    lakes = [water["flooded"](ground, level, source) for level in levels]
    volumes = [np.sum((level - ground)[wet]) for level, wet in zip(levels, lakes, strict=True)]
    for i in range(len(levels) - 1):
        assert not np.any(lakes[i] & ~lakes[i + 1])
        assert 0.5 * lakes[i].sum() <= volumes[i + 1] - volumes[i]
        newly = lakes[i + 1] & ~lakes[i] & (ground < levels[i])  # pits that it has run over into
        gained = 0.5 * lakes[i + 1].sum() + np.sum((levels[i] - ground)[newly])
        assert volumes[i + 1] - volumes[i] <= gained + 1e-9


def test_a_lake_that_rises_is_renewed_as_if_afresh(water, basin):
    ground, source = basin
    lod = rtin.LevelOfDetail(rtin.Grid(ground))
    for level in (1.0, 4.0, 4.5, 12.0, 25.0):
        water["rise"](lod, ground, level, source)
        assert_as_afresh(lod)


def test_a_kept_shore_parts_land_from_water(water, basin):
    ground, source = basin
    wet = water["flooded"](ground, 10.0, source)
    surface = rtin.Grid(np.where(wet, 10.0, ground))
    mesh = rtin.coarsen(surface, max_error=5.0, keep=water["shore"](wet))
    x, y, _ = mesh.vertices.astype(int).T
    n_wet = wet[-y, x][mesh.triangles].sum(axis=1)
    mixed = (n_wet > 0) & (n_wet < 3)
    assert mixed.any()
    assert (mesh.signed_areas()[mixed] == 0.5).all()
    assert (mesh.signed_areas()[n_wet == 3] > 0.5).any()
