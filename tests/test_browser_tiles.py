"""The pages of the server, in a real browser without a network."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from pyproj import Transformer

import rtin
from rtin import samples, serve
from rtin.schemes import SCHEMES
from test_html_page import CHROMIUM, FLAGS, pixels
from test_serve import serving
from tilesets import write_fault

CESIUM = Path(os.environ.get("RTIN_CESIUM", Path(__file__).parent))
CENTRE = (-84.25, 36.59)
WAIT = 60_000  # milliseconds until something has gone wrong

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")
needs_cesium = pytest.mark.skipif(
    serve._find_cesium(CESIUM) is None, reason="needs CesiumJS: npm install --prefix tests"
)


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    """A folder of tiles, the heights they are of, and how far they may be off."""
    folder = tmp_path_factory.mktemp("terrain")
    return folder, *write_fault(folder)


class Visit:
    """A page, and all that it complained of and asked others for."""

    def __init__(self, browser, port, path):
        self.complaints, self.asked = [], []
        self.page = browser.new_page(viewport={"width": 500, "height": 400})
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


def test_the_viewer_draws_the_terrain_with_nothing_from_outside(browser, terrain):
    with serving(serve.FolderStore(terrain[0])) as port:
        visit = Visit(browser, port, "viewer.html")
        visit.until("document.body.dataset.state === 'ready' && document.body.dataset.tiles > 8")
        visit.page.wait_for_timeout(300)
        shown = pixels(visit.page)
        visit.page.check("#wireframe")
        visit.page.wait_for_timeout(500)
        wireframe = pixels(visit.page)
        counts, credit = visit.page.inner_text("#counts"), visit.page.inner_text("#credit")
        visit.page.close()
    visit.assert_clean()
    assert detail(shown) > 12
    assert np.mean(np.any(shown != wireframe, axis=2)) > 0.1
    assert "triangles" in counts
    assert credit == "Sample data of matplotlib"


def test_the_viewer_loads_finer_tiles_when_it_comes_near(browser, terrain):
    with serving(serve.FolderStore(terrain[0])) as port:
        visit = Visit(browser, port, "viewer.html")
        visit.until("document.body.dataset.state === 'ready' && document.body.dataset.tiles > 8")
        assert not any("/13/" in url for url in visit.asked)
        visit.page.mouse.move(400, 300)  # beside the panel
        for _ in range(3):
            visit.page.mouse.wheel(0, -600)
        visit.until("document.getElementById('counts').textContent.includes('to 13')")
        visit.page.close()
    visit.assert_clean()


def test_the_viewer_says_what_it_lacks(browser, tmp_path):
    (tmp_path / "tileset.json").write_text("{}")
    with serving(serve.FolderStore(tmp_path)) as port:
        visit = Visit(browser, port, "viewer.html")
        visit.until("document.body.dataset.state === 'failed'")
        assert "there is no layer.json" in visit.page.inner_text("#message")
        visit.page.close()


def test_without_cesium_its_page_says_how_to_get_it(browser, terrain, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with serving(serve.FolderStore(terrain[0])) as port:
        visit = Visit(browser, port, "cesium.html")
        visit.page.wait_for_selector("#message:visible")
        assert "npm install cesium" in visit.page.inner_text("#message")
        visit.page.close()


@needs_cesium
def test_cesium_renders_the_terrain_and_reads_its_heights(browser, terrain):
    folder, heights_at, tolerance = terrain
    with serving(serve.FolderStore(folder), cesium=CESIUM) as port:
        visit = Visit(browser, port, "cesium.html")
        visit.until("document.body.dataset.state === 'ready'")
        visit.page.wait_for_timeout(2500)  # it flies there
        visit.until("widget.scene.globe.tilesLoaded")
        shown = canvas_pixels(visit.page)
        lon = np.linspace(CENTRE[0] - 0.1, CENTRE[0] + 0.1, 23)
        lat = np.linspace(CENTRE[1] - 0.08, CENTRE[1] + 0.09, 23)
        sampled = sample(visit.page, lon, lat)
        visit.page.evaluate("widget.terrainProvider = new Cesium.EllipsoidTerrainProvider()")
        visit.page.wait_for_timeout(1000)
        visit.until("widget.scene.globe.tilesLoaded")
        bare = canvas_pixels(visit.page)
        visit.page.close()
    visit.assert_clean()
    assert detail(shown) > 12
    assert detail(bare) < 6
    assert np.mean(np.abs(shown - bare).max(axis=2) > 20) > 0.1
    np.testing.assert_allclose(sampled, heights_at(lon, lat), rtol=0, atol=tolerance)


def canvas_pixels(page):
    """The globe without the panel and the credits."""
    for element in page.query_selector_all(".panel, .credit, .cesium-widget-credits"):
        element.evaluate("element => { element.hidden = true; }")
    return pixels(page)


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
def test_cesium_draws_3d_tiles_and_stands_on_them(browser, tmp_path, scheme):
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
        seen = canvas_pixels(visit.page)
        stood_on = sample_tiles(visit.page, lon, lat)
        visit.page.close()
    visit.assert_clean()
    sky, ground = seen[:60].mean(), seen[180:280, 180:320]
    assert ground.mean() > sky + 60
    assert ground.mean(axis=2).std() > 6
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
