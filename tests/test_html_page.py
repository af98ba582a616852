"""The self-contained page, in a real browser without a network."""

import numpy as np
import pytest

import rtin
from chromium import CHROMIUM, FLAGS, seen, terrain_share
from rtin import samples


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
        shown = seen(page, lambda picture: terrain_share(picture) > 0.2)
        page.keyboard.press("w")
        wireframe = seen(page, lambda picture: np.any(picture != shown))
        title = page.title()
        browser.close()
    assert not complaints
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert title.startswith("rtin: ")
    assert terrain_share(shown) > 0.2
    assert np.any(shown != wireframe)
