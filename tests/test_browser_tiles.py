"""The pages of the server, in a real browser without a network."""

import json
import os
from math import pi, radians, sin
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from pyproj import Transformer

import rtin
from chromium import CHROMIUM, FLAGS, seen, share_unlike
from islands import write_island
from rtin import samples, serve
from rtin.io.live_tiles import LiveTiles
from rtin.schemes import EQUATORIAL_RADIUS, SCHEMES
from test_serve import serving

CESIUM = Path(os.environ.get("RTIN_CESIUM", Path(__file__).parent))
WAIT = 60_000  # milliseconds until something has gone wrong
LARGEST = 32767  # u and v of quantized-mesh are 0 to this
NORTH = 36.6
CENTRE = (-84.25, 36.59)  # of the Jacksboro fault

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")
needs_cesium = pytest.mark.skipif(
    serve._find_cesium(CESIUM) is None, reason="needs CesiumJS: npm install --prefix tests"
)


class Tilesets:
    """Jobs of the island, and what serves their tiles; each is made once."""

    def __init__(self, folder):
        self.folder, self.made = folder, {}

    def get(self, kind="terrain", scheme="geographic", west=-84.3, live=False):
        key = f"{kind}-{scheme}{west}-{live}"
        if key not in self.made:
            raster = write_island(self.folder / f"{key}.tif", west, NORTH)
            about = {"name": "Island", "attribution": "Nobody's island"}
            job = rtin.world_tiles([raster], kind, scheme=scheme, max_error=[4.0], about=about)
            self.made[key] = job, self._store(job, self.folder / key, live)
        return self.made[key]

    def _store(self, job, folder, live):
        if live:
            folder.mkdir()
            return LiveTiles(job, folder)
        job.write(folder)
        return serve.FolderStore(folder)


@pytest.fixture(scope="module")
def tilesets(tmp_path_factory):
    return Tilesets(tmp_path_factory.mktemp("tilesets"))


class Visit:
    """A page, and all that it complained of and asked others for."""

    def __init__(self, browser, port, path):
        self.complaints, self.asked = [], []
        self.page = browser.new_page(viewport={"width": 400, "height": 300})
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._hear)
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.home = f"http://127.0.0.1:{port}/"
        self.page.goto(self.home + path)

    def _hear(self, message):
        if message.type in ("error", "warning") and "GPU stall" not in message.text:
            self.complaints.append(message.text)

    def until(self, condition):
        """Wait; the page's policy forbids Playwright's own way, which evaluates a string there."""
        for _ in range(WAIT // 100):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(100)
        pytest.fail(f"never {condition}; {self.complaints}")

    def assert_clean(self):
        assert self.complaints == []
        assert [u for u in self.asked if not u.startswith((self.home, "data:", "blob:"))] == []


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


def detail(picture):
    """Standard deviation of the lower half's brightness: level ground has hardly any."""
    return picture[picture.shape[0] // 2 :].mean(axis=2).std()


def open_viewer(browser, port):
    visit = Visit(browser, port, "viewer.html")
    visit.until("document.body.dataset.state === 'ready' && document.body.dataset.tiles > 8")
    return visit


@pytest.mark.parametrize(("scheme", "live"), [("geographic", False), ("mercator", True)])
def test_the_viewer_draws_the_terrain_with_nothing_from_outside(browser, tilesets, scheme, live):
    _, store = tilesets.get(scheme=scheme, live=live)
    with serving(store) as port:
        visit = open_viewer(browser, port)
        shown = seen(visit.page, lambda picture: detail(picture) > 12)
        visit.page.check("#wireframe")
        wireframe = seen(visit.page, lambda picture: share_unlike(picture, shown, by=0) > 0.1)
        counts, credit = visit.page.inner_text("#counts"), visit.page.inner_text("#credit")
        visit.page.close()
    visit.assert_clean()
    assert detail(shown) > 12
    assert share_unlike(shown, wireframe, by=0) > 0.1
    assert "triangles" in counts
    assert credit == "Nobody's island"


def test_the_viewer_loads_finer_tiles_when_it_comes_near(browser, tilesets):
    job, store = tilesets.get()
    last = max(job.plan.tolerances)
    with serving(store) as port:
        visit = open_viewer(browser, port)
        assert not any(f"/{last}/" in url for url in visit.asked)
        visit.page.mouse.move(320, 220)  # beside the panel
        for _ in range(3):
            visit.page.mouse.wheel(0, -600)
        visit.until(f"document.getElementById('counts').textContent.includes('to {last}')")
        visit.page.close()
    visit.assert_clean()


def test_the_viewer_says_what_it_lacks(browser, tmp_path):
    (tmp_path / "tileset.json").write_text("{}")
    with serving(serve.FolderStore(tmp_path)) as port:
        visit = Visit(browser, port, "viewer.html")
        visit.until("document.body.dataset.state === 'failed'")
        assert "there is no layer.json" in visit.page.inner_text("#message")
        visit.page.close()


def test_without_cesium_its_page_says_how_to_get_it(browser, tilesets, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with serving(tilesets.get()[1]) as port:
        visit = Visit(browser, port, "cesium.html")
        visit.page.wait_for_selector("#message:visible")
        assert "npm install cesium" in visit.page.inner_text("#message")
        visit.page.close()


# --- CesiumJS -----------------------------------------------------------------------------------


def open_cesium(browser, port):
    visit = Visit(browser, port, "cesium.html")
    visit.until("document.body.dataset.state === 'ready'")
    return visit


@needs_cesium
def test_cesium_renders_the_terrain(browser, tilesets):
    with serving(tilesets.get()[1], cesium=CESIUM) as port:
        visit = open_cesium(browser, port)
        visit.until("document.body.dataset.there === 'true'")
        hide_all_but_the_globe(visit.page)
        shown = seen(visit.page, lambda picture: detail(picture) > 12)
        visit.page.evaluate("widget.terrainProvider = new Cesium.EllipsoidTerrainProvider()")
        bare = seen(visit.page, lambda picture: detail(picture) < 6)
        visit.page.close()
    visit.assert_clean()
    assert detail(shown) > 12
    assert detail(bare) < 6
    assert share_unlike(shown, bare, by=20) > 0.1


@needs_cesium
@pytest.mark.parametrize(
    ("scheme", "west", "live"),
    [("geographic", -84.3, False), ("mercator", -84.3, True), ("geographic", 179.91, True)],
    ids=["geographic", "mercator", "across the antimeridian"],
)
def test_cesium_reads_the_heights_of_the_raster(browser, tilesets, scheme, west, live):
    job, store = tilesets.get(scheme=scheme, west=west, live=live)
    lon, lat, heights = some_nodes(job)
    with serving(store, cesium=CESIUM) as port:
        visit = open_cesium(browser, port)
        sampled = sample(visit.page, lon, lat)
        visit.page.close()
    visit.assert_clean()
    assert np.ptp(heights) > 300
    tolerance = job.plan.tolerances[max(job.plan.tolerances)]
    allowed = tolerance + of_rounding_places(job)
    np.testing.assert_allclose(sampled, heights, rtol=0, atol=allowed)


def some_nodes(job, count=400):
    """Longitude, latitude and height of nodes of the finest zoom: of these rtin promises."""
    lattice, rng = job.plan.lattice, np.random.default_rng(1)
    rows, cols = (rng.integers(*span, count) for span in (lattice.rows, lattice.cols))
    heights = lattice.read(lattice.rows, lattice.cols)
    x = lattice.transform.c + lattice.transform.a * (cols % lattice.period)
    y = lattice.transform.f + lattice.transform.e * rows
    if SCHEMES[job.output.scheme].crs == "EPSG:3857":
        x, y = x / EQUATORIAL_RADIUS, np.arctan(np.sinh(y / EQUATORIAL_RADIUS))
        x, y = np.degrees(x), np.degrees(y)
    return x, y, heights[rows - lattice.rows[0], cols - lattice.cols[0]]


def of_rounding_places(job):
    """Metres by which a height may change since u and v are whole numbers, and by Mercator.

    Places are off by half a step of u and of v; in Mercator, where v goes by latitude and the
    lattice by y, also by how far the one is from linear in the other within a tile. A triangle's
    slope along an axis is at most twice the largest step between two nodes.
    """
    lattice, cells = job.plan.lattice, job.plan.cells
    heights = lattice.read(lattice.rows, lattice.cols)
    steepest = 2 * max(np.abs(np.diff(heights, axis=axis)).max() for axis in (0, 1))
    off = 2 * 0.5 * cells / LARGEST
    if job.output.scheme == "mercator":
        off += cells * 2 * pi / 2 ** max(job.plan.tolerances) / 8 * sin(radians(NORTH))
    return steepest * off


@needs_cesium
def test_cesium_renders_3d_tiles(browser, tilesets):
    with serving(tilesets.get("3dtiles")[1], cesium=CESIUM) as port:
        visit = open_cesium(browser, port)
        visit.until("document.body.dataset.there === 'true'")
        visit.page.wait_for_selector("#counts:text-is('all tiles in sight are loaded')")
        hide_all_but_the_globe(visit.page)
        shown = seen(visit.page, lambda picture: detail(picture) > 12)
        visit.page.evaluate("shown.show = false")
        empty = seen(visit.page, lambda picture: share_unlike(picture, shown, by=20) > 0.1)
        visit.page.close()
    visit.assert_clean()
    assert detail(shown) > 12
    assert share_unlike(shown, empty, by=20) > 0.1


def hide_all_but_the_globe(page):
    for element in page.query_selector_all(".panel, .credit, .cesium-widget-credits"):
        element.evaluate("element => { element.hidden = true; }")


def sample(page, lon, lat):
    """The heights that CesiumJS finds in the finest tiles."""
    places = json.dumps(np.column_stack([lon, lat]).tolist())
    return page.evaluate(
        f"""Cesium.sampleTerrainMostDetailed(shown,
            {places}.map(([lon, lat]) => Cesium.Cartographic.fromDegrees(lon, lat)))
            .then((found) => found.map((place) => place.height))"""
    )


@needs_cesium
@pytest.mark.parametrize("scheme", SCHEMES)
def test_cesium_stands_on_3d_tiles(browser, tmp_path, scheme):
    grid, zoom, max_error = samples.jacksboro_fault(), {"geographic": 12, "mercator": 13}, 8.0
    write_raster(tmp_path / "fault.tif", grid)
    job = rtin.world_tiles(
        [tmp_path / "fault.tif"], "3dtiles", scheme=scheme, zoom=(6, zoom[scheme]),
        max_error=[max_error],
    )  # fmt: skip
    job.write(tmp_path / "tiles")
    a, _, c, _, e, f = SCHEMES[scheme].transform(zoom[scheme], job.plan.cells)[:6]
    to_lonlat = Transformer.from_crs(SCHEMES[scheme].crs, "EPSG:4326", always_xy=True)
    to_xy = Transformer.from_crs("EPSG:4326", SCHEMES[scheme].crs, always_xy=True)
    x, y = to_xy.transform(CENTRE[0] + np.linspace(-0.1, 0.1, 9), np.linspace(36.51, 36.68, 9))
    lon, lat = to_lonlat.transform(c + a * np.rint((x - c) / a), f + e * np.rint((y - f) / e))
    with serving(serve.FolderStore(tmp_path / "tiles"), cesium=CESIUM) as port:
        visit = Visit(browser, port, "cesium.html")
        visit.until("document.body.dataset.state === 'ready'")
        visit.page.evaluate("shown.maximumScreenSpaceError = 0.2")
        visit.page.wait_for_timeout(2500)  # it flies there
        visit.until("shown.tilesLoaded")
        stood_on = sample_tiles(visit.page, lon, lat)
        visit.page.close()
    visit.assert_clean()
    # What is sampled is the picture's depth, not the mesh itself.
    wanted = grid.heights_at(np.column_stack([lon, lat]))
    np.testing.assert_allclose(stood_on, wanted, rtol=0, atol=max_error + 0.5)


def write_raster(path, grid):
    import rasterio

    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": "EPSG:4326"}
    rows, cols = grid.shape
    a, _, c, _, e, f = grid.transform[:6]
    corner = Affine(a, 0.0, c - a / 2.0, 0.0, e, f - e / 2.0)
    with rasterio.open(path, "w", height=rows, width=cols, transform=corner, **profile) as file:
        file.write(grid.heights, 1)


def sample_tiles(page, lon, lat):
    """The heights that CesiumJS finds in the finest 3D Tiles."""
    places = json.dumps(np.column_stack([lon, lat]).tolist())
    return page.evaluate(
        f"""widget.scene.sampleHeightMostDetailed(
            {places}.map(([lon, lat]) => Cesium.Cartographic.fromDegrees(lon, lat)))
            .then((found) => found.map((place) => place.height))"""
    )
