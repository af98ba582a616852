"""The self-contained page, in a real browser without a network."""

import io
import shutil

import numpy as np
import pytest
from PIL import Image

import rtin
from rtin import samples

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")
def test_the_page_shows_the_terrain_and_asks_nobody_for_anything(tmp_path):
    from playwright.sync_api import sync_playwright

    path = tmp_path / "terrain.html"
    rtin.write_mesh(rtin.coarsen(samples.topobathy(), max_error=50.0), path)
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 400, "height": 300})
        requests, complaints = [], []
        page.on("request", lambda request: requests.append(request.url))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(path.as_uri())
        page.wait_for_selector("canvas")
        page.wait_for_timeout(1500)
        shown = pixels(page)
        page.keyboard.press("w")
        page.wait_for_timeout(500)
        wireframe = pixels(page)
        title = page.title()
        browser.close()
    assert not complaints
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert title.startswith("rtin: ")
    assert terrain_share(shown) > 0.2
    assert np.any(shown != wireframe)


def pixels(page):
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), np.int16)


def terrain_share(picture):
    """Share of the pixels that have a colour: the page itself is white, its text grey."""
    return np.mean(np.ptp(picture, axis=2) > 15)
