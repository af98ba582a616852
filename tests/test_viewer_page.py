"""The page that shows a terrain: its logic, and the page itself in a real browser."""

import asyncio
import gc
import io
import json
import socket
import subprocess
import sys
import threading
import time
import weakref
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import rtin
from chromium import CHROMIUM, FLAGS, pixels, seen, share_unlike
from film import as_shown

pytest.importorskip("viser")

from rtin.viewer import page as pages
from rtin.viewer import scene
from rtin.viewer._panel import told
from rtin.viewer.opening import Opening
from rtin.viewer.scene import SIDE, Place, Settings, Terrain, View
from test_serve import interrupted, started

_CALM = 5  # times 50 ms: how long a camera rests before it is taken to stay
OVERVIEW = View((0.0, -75.0, 55.0), (0.0, -5.0, 0.0), height=600)


def hills(shape=(129, 200), step=30.0):
    """A grid of ridges and noise, 600 m high, in metres far from the origin."""
    row, col = np.indices(shape)
    noise = np.random.default_rng(1).normal(size=shape)
    heights = 300.0 + 250.0 * np.sin(row / 17) * np.cos(col / 23) + 8.0 * noise
    return rtin.Grid(heights.astype("f4"), (step, 0.0, 4e5, 0.0, -step, 5e6))


def painted_in(colour):
    """A painter that knows one colour."""
    return lambda mesh: np.tile(colour, (mesh.n_vertices, 1))


@pytest.fixture(scope="module")
def terrain():
    return Terrain(hills())


# --- the scene ------------------------------------------------------------------------------------


def decoded(glb):
    """Positions, triangles and all else that a GLB says."""
    length = int.from_bytes(glb[12:16], "little")
    tree, binary = json.loads(glb[20 : 20 + length]), glb[28 + length :]

    def values(number, dtype, width):
        accessor = tree["accessors"][number]
        view = tree["bufferViews"][accessor["bufferView"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(part, dtype).reshape(-1, width)

    (triangles,) = tree["meshes"][0]["primitives"]
    lines = tree["meshes"][1]["primitives"][0]["indices"] if len(tree["meshes"]) > 1 else None
    if "TEXCOORD_0" in triangles["attributes"]:
        (image,) = tree["images"]
        view = tree["bufferViews"][image["bufferView"]]
        jpeg = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        picture = np.asarray(Image.open(io.BytesIO(jpeg)))
        uv = values(triangles["attributes"]["TEXCOORD_0"], "<u2", 2) / 65535.0
        colours = picture[tuple((uv * 0.999 * picture.shape[1::-1]).astype(int).T[::-1])]
    else:
        colours = values(triangles["attributes"]["COLOR_0"], "<u2", 4)
    return (
        values(triangles["attributes"]["POSITION"], "<f4", 3),
        values(triangles["indices"], "<u4", 3),
        colours,
        None if lines is None else values(lines, "<u4", 2),
    )


@settings(deadline=None)
@given(st.floats(0.1, 10.0), st.lists(st.floats(-1e4, 1e4), min_size=3, max_size=3))
def test_the_world_and_the_scene_are_each_others_inverse(exaggeration, offset):
    place = Place.of(np.array([[4e5, 5e6, -20.0], [4.3e5, 5.1e6, 3000.0]]))
    point = place.middle + offset
    there = place.into_scene(point, exaggeration)
    assert np.allclose(place.into_world(there, exaggeration), point, rtol=1e-12)


def test_what_has_no_extent_has_a_place_too():
    place = Place.of(np.array([[7.0, 8.0, 0.0], [7.0, 8.0, 9.0]]))
    assert place.into_scene([7.0, 8.0, 9.0]).tolist() == [0.0, 0.0, 4.5 * SIDE]


def test_the_longer_side_of_a_scene_is_known_and_its_middle_is_zero(terrain):
    positions, _, _, _ = decoded(terrain.draw(OVERVIEW, Settings()).glb)
    assert np.allclose([positions.min(axis=0)[0], positions.max(axis=0)[0]], [-SIDE / 2, SIDE / 2])
    assert np.abs(positions).max() <= SIDE / 2 * (1 + 1e-6)


@pytest.mark.parametrize(
    "chosen",
    [
        Settings(pixel_error=4.0),
        Settings("triangle budget", max_triangles=3000),
        Settings("tolerance", max_error=40.0),
    ],
)
def test_a_picture_is_the_mesh_that_was_asked_for(terrain, chosen):
    picture = terrain.draw(OVERVIEW, chosen)
    positions, triangles, colours, edges = decoded(picture.glb)
    assert (len(positions), len(triangles)) == (picture.n_vertices, picture.n_triangles)
    assert len(colours) == len(positions)
    assert edges is None
    mesh = rtin.TriangleMesh(terrain.place.into_world(positions), triangles.astype(int))
    assert np.all(mesh.signed_areas() > 0.0)
    if chosen.mode == "triangle budget":
        assert 2000 < picture.n_triangles <= 3000
    else:
        assert picture.kept == (40.0 if chosen.mode == "tolerance" else 4.0)


def test_a_tolerance_holds_for_what_is_drawn(terrain):
    picture = terrain.draw(OVERVIEW, Settings("tolerance", max_error=25.0))
    positions, triangles, _, _ = decoded(picture.glb)
    vertices = terrain.place.into_world(positions)
    grid = hills()
    rows_cols = np.rint(grid.places(vertices[:, :2])).astype(int)
    back = np.column_stack(
        [rows_cols[:, 1] * 30.0 + 4e5, 5e6 - rows_cols[:, 0] * 30.0, vertices[:, 2]]
    )
    mesh = rtin.TriangleMesh(back, triangles.astype(int))
    assert rtin.vertical_error(mesh, grid).max <= 25.0 + 0.01  # float32 in a scene of 100 units


UPWARDS = View((0.0, -60.0, -2.0), (0.0, 0.0, 6.0), field_of_view=15.0, height=600)
WIDE = View((0.0, -20.0, 20.0), (0.0, 0.0, 4.0), field_of_view=165.0, height=9000)


@pytest.mark.parametrize("view", [OVERVIEW, UPWARDS, WIDE], ids=["overview", "upwards", "wide"])
@pytest.mark.parametrize("exaggeration", [0.6, 5.0])
def test_an_exaggerated_error_keeps_the_pixels(terrain, view, exaggeration):
    """As if the raster had been so high, seen from the same place."""
    picture = terrain.draw(view, Settings(pixel_error=3.0, exaggeration=exaggeration))
    positions, triangles, _, _ = decoded(picture.glb)
    samples = scene_of(hills(), terrain.place, exaggeration)
    errors = np.abs(heights_on(positions, triangles, samples) - samples[:, 2])
    seen = inside(view, samples)
    focal = view.height / (2.0 * np.tan(np.radians(view.field_of_view) / 2.0))
    off = focal * errors / np.linalg.norm(samples - view.eye, axis=1)
    seen_and_covered = seen & np.isfinite(errors)
    assert seen_and_covered.sum() > max(500, 0.98 * seen.sum())
    assert off[seen_and_covered].max() <= 3.0 * (1 + 1e-3)
    assert picture.kept == pytest.approx(3.0)


@pytest.mark.parametrize("shape", [(40, 129), (100, 100)])
def test_an_exaggeration_is_as_if_the_raster_were_so_high(shape):
    """Its outline, too, which has no height to be multiplied."""
    grid = hills(shape)
    terrain = Terrain(grid)
    lower = rtin.Grid(grid.heights / 8.0, grid.transform)
    for chosen in (Settings(pixel_error=4.0), Settings("triangle budget", max_triangles=400)):
        shown = terrain.shown(OVERVIEW, replace(chosen, exaggeration=0.125))
        other = Terrain(lower).shown(OVERVIEW, chosen)
        np.testing.assert_array_equal(shown.mesh.triangles, other.mesh.triangles)
        np.testing.assert_allclose(shown.vertices, other.vertices, atol=1e-9)


@pytest.mark.parametrize("heights", [np.pad([[1.0]], 4, constant_values=np.nan)])
def test_what_has_no_triangle_cannot_be_drawn(heights):
    with pytest.raises(ValueError, match="the grid has no triangle to keep"):
        Terrain(rtin.Grid(heights)).draw(OVERVIEW, Settings())


def test_terrain_out_of_sight_can_be_drawn():
    heights = np.full((9, 9), np.nan)
    heights[:3, :3] = 1.0
    terrain = Terrain(rtin.Grid(heights))
    away = View((0.0, 0.0, 50.0), (90.0, -90.0, 99.0))
    assert terrain.draw(away, Settings()).n_triangles > 0


def test_nothing_but_terrain_has_a_page():
    with pytest.raises(TypeError, match="a Grid or a TriangleMesh is wanted, got str"):
        Terrain("hills")
    with pytest.raises(TypeError, match="a Terrain is wanted, got Grid"):
        pages.Page(hills(), port=0)


def scene_of(grid, place, exaggeration):
    """All samples, as they lie in the scene."""
    row, col = np.indices(grid.shape)
    x, y = 4e5 + 30.0 * col.ravel(), 5e6 - 30.0 * row.ravel()
    return place.into_scene(np.column_stack([x, y, grid.heights.ravel()]), exaggeration)


def heights_on(positions, triangles, samples):
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    x, y, z = np.float64(positions).T
    surface = LinearTriInterpolator(Triangulation(x, y, triangles), z)
    heights = surface(*(samples[:, :2] * (1.0 - 1e-6)).T)
    return np.ma.filled(heights, np.nan)


def inside(view, points):
    planes = rtin.lod.frustum(
        view.eye, view.target, field_of_view=view.field_of_view, aspect=view.aspect
    )
    return np.all(points @ planes[:, :3].T + planes[:, 3] >= 0.0, axis=1)


def test_vertices_glide_between_levels_for_a_camera_only(terrain):
    def is_moved(chosen):
        positions, _, _, _ = decoded(terrain.draw(OVERVIEW, chosen).glb)
        vertices = terrain.place.into_world(positions)
        grid = hills()
        row, col = np.rint(grid.places(vertices[:, :2])).astype(int).T
        return np.abs(vertices[:, 2] - grid.heights[row, col]) > 0.01

    assert 0.02 < is_moved(Settings(pixel_error=3.0)).mean() < 0.9
    assert not is_moved(Settings("tolerance", max_error=20.0)).any()


def test_outside_of_what_is_seen_there_is_little(terrain):
    near = View((0.0, -10.0, 8.0), (0.0, 10.0, 0.0), field_of_view=30.0, height=600)
    positions, _, _, _ = decoded(terrain.draw(near, Settings()).glb)
    south_of_the_eye = positions[:, 1] < -20.0
    assert south_of_the_eye.mean() < 0.1
    assert len(positions) > 500


def test_a_picture_depends_on_the_camera_only_where_the_mesh_does(terrain):
    elsewhere = replace(OVERVIEW, eye=(1.0, 2.0, 30.0))
    for chosen in (Settings(), Settings("triangle budget")):
        assert terrain.depends_on(OVERVIEW, chosen) != terrain.depends_on(elsewhere, chosen)
        assert terrain.depends_on(OVERVIEW, chosen) == terrain.depends_on(replace(OVERVIEW), chosen)
    chosen = Settings("tolerance", max_error=3.0)
    assert terrain.depends_on(OVERVIEW, chosen) == terrain.depends_on(elsewhere, chosen)
    assert terrain.depends_on(OVERVIEW, chosen) != terrain.depends_on(
        OVERVIEW, Settings("tolerance")
    )
    others = replace(chosen, pixel_error=7.0, max_triangles=9)
    assert terrain.depends_on(OVERVIEW, chosen) == terrain.depends_on(OVERVIEW, others)


@pytest.mark.parametrize(
    "chosen", [Settings(pixel_error=0.01), Settings("triangle budget", max_triangles=10**6),
               Settings("tolerance", max_error=0.0)]
)  # fmt: skip
def test_a_picture_is_never_more_than_the_page_draws(terrain, chosen, monkeypatch):
    monkeypatch.setattr(scene, "MOST_TRIANGLES", 5000)
    picture = terrain.draw(OVERVIEW, chosen)
    assert 4000 < picture.n_triangles <= 5000
    assert picture.is_cut_short
    assert "as many as the page draws" in told(picture, chosen, 0.1)


def test_the_wireframe_has_each_edge_once(terrain):
    picture = terrain.draw(OVERVIEW, Settings("tolerance", max_error=40.0, wireframe=True))
    positions, triangles, _, edges = decoded(picture.glb)
    mesh = rtin.TriangleMesh(positions, triangles.astype(int))
    assert np.array_equal(edges, mesh.edges())
    length = int.from_bytes(picture.glb[12:16], "little")
    _, net = json.loads(picture.glb[20 : 20 + length])["nodes"]
    x, y, lift = net["translation"]
    assert x == y == 0.0
    assert 1e-4 < lift / np.linalg.norm(np.subtract(OVERVIEW.eye, OVERVIEW.target)) < 1e-2


def test_a_mesh_is_shown_as_it_is():
    mesh = rtin.coarsen(hills(), max_error=30.0)
    shown = Terrain(mesh)
    picture = shown.draw(OVERVIEW, Settings())
    positions, triangles, _, _ = decoded(picture.glb)
    assert not shown.has_levels
    assert picture.kept is None
    assert np.array_equal(triangles, mesh.triangles)
    assert np.allclose(shown.place.into_world(positions), mesh.vertices, atol=0.01)
    assert shown.depends_on(OVERVIEW, Settings()) == shown.depends_on(
        replace(OVERVIEW, up=(1, 0, 0)), Settings()
    )


def test_the_colours_are_those_that_a_painter_gives():
    painted = Terrain(hills((9, 9)), painters={"brown": painted_in((0.7, 0.5, 0.2))})
    colours = decoded(painted.draw(OVERVIEW, Settings()).glb)[2]
    assert np.unique(colours[:, 3]) == [65535]
    assert np.allclose(as_shown(colours), np.multiply(255.0, [0.7, 0.5, 0.2]), atol=0.5)


def test_slopes_towards_the_light_are_brighter():
    _, col = np.indices((9, 9))
    ridge = rtin.Grid(10.0 * np.minimum(col, 8 - col), (10.0, 0.0, 0.0, 0.0, -10.0, 0.0))
    positions, _, colours, _ = decoded(Terrain(ridge).draw(OVERVIEW, Settings()).glb)
    west, east = positions[:, 0] < -1.0, positions[:, 0] > 1.0
    assert colours[west, :3].mean() > 1.2 * colours[east, :3].mean()


# --- the newest view ------------------------------------------------------------------------------


def test_of_many_views_only_the_newest_is_drawn_next():
    async def watch():
        wanted, drawn = [0], []

        async def draw():
            drawn.append(wanted[-1])
            await asyncio.sleep(0.02)

        newest = pages.Newest(draw, lambda error: None)
        for number in range(100):
            wanted.append(number)
            newest.ask()
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.1)
        newest.end()
        return drawn

    drawn = asyncio.run(watch())
    assert drawn[-1] == 99
    assert 2 < len(drawn) < 50
    assert drawn == sorted(set(drawn))


def test_a_picture_that_fails_is_told_and_the_next_one_is_drawn(caplog):
    async def watch():
        told, drawn = [], []

        async def draw():
            drawn.append(1)
            if len(drawn) == 1:
                raise ValueError("no triangle")

        newest = pages.Newest(draw, told.append)
        for _ in range(2):
            newest.ask()
            await asyncio.sleep(0.01)
        newest.end()
        return told, drawn

    told, drawn = asyncio.run(watch())
    assert [str(error) for error in told] == ["no triangle"]
    assert len(drawn) == 2


# --- the server -----------------------------------------------------------------------------------


def test_a_taken_port_is_told(terrain):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OSError, match=f"port {port} of 127.0.0.1: another program uses it"):
            pages.Page(terrain, port=port)
    with pytest.raises(ValueError, match="port must be 0 to 65535, got 70000"):
        pages.Page(terrain, port=70000)


def test_a_port_that_is_taken_meanwhile_is_told(terrain, monkeypatch):
    """viser itself would serve on the next one."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        monkeypatch.setattr(pages, "listening", lambda host, port: taken.dup())
        with pytest.raises(OSError, match="another program has just taken it"):
            pages.Page(terrain, port=0)


def test_a_window_without_any_height_is_taken_for_a_small_one():
    camera = SimpleNamespace(
        image_height=0, image_width=0, fov=1.0, position=(0.0, -9.0, 5.0),
        look_at=(0.0, 0.0, 0.0), up_direction=(0.0, 0.0, 1.0),
    )  # fmt: skip
    view = pages._view(camera)
    assert (view.height, view.aspect) == (16, 1.0)
    assert view.field_of_view == pytest.approx(np.degrees(1.0))


def test_a_page_may_be_closed_twice_and_lets_nobody_in_after(terrain):
    with pages.Page(terrain, port=0) as page:
        page.close()
        asyncio.run(page._welcome(None))
    assert page.visitors == {}


def test_a_page_prints_nothing_and_leaves_no_thread(terrain, capfd):
    before = set(threading.enumerate())
    with pages.Page(terrain, port=0) as page:
        assert page.address.startswith("http://127.0.0.1:")
    until(lambda: set(threading.enumerate()) <= before)
    assert capfd.readouterr() == ("", "")


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.02)


@pytest.mark.parametrize("exaggeration", [1.0, 4.0])
def test_all_of_a_tall_terrain_is_seen_at_first(exaggeration):
    heights = 8.0 * hills((33, 33)).heights
    tall = Terrain(rtin.Grid(heights, (30.0, 0.0, 0.0, 0.0, -30.0, 0.0)))
    with pages.Page(tall, port=0, settings=Settings(exaggeration=exaggeration)) as page:
        camera = page._server.initial_camera
        first = View(tuple(camera.position), tuple(camera.look_at))
        reach = np.linalg.norm(np.subtract(first.eye, first.target))
        assert reach < camera.far / 2.0
    (west, south, low), (east, north, high) = tall.bounds
    corners = [(x, y, z) for x in (west, east) for y in (south, north) for z in (low, high)]
    assert inside(first, tall.place.into_scene(corners, exaggeration)).all()


# --- in a browser ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("needs Debian's chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def page(terrain):
    with pages.Page(terrain, port=0, title="Hills") as page:
        yield page


@pytest.fixture
def own_page(terrain):
    with pages.Page(terrain, port=0) as page:
        yield page


class Tab:
    """A tab that looks at a page, and the server's visitor for it."""

    def __init__(self, browser, page):
        self.complaints, self.asked = [], []
        self.home = page.address
        known = set(page.visitors)
        self.tab = browser.new_page(viewport={"width": 640, "height": 400})
        self.tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.tab.on("console", self._hear)
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.on("websocket", lambda channel: self.asked.append(channel.url))
        self.tab.goto(page.address)
        self.until(lambda: set(page.visitors) - known)
        (self.number,) = set(page.visitors) - known
        self.visitor = page.visitors[self.number]
        self.until(lambda: self.visitor.picture is not None)
        self.tab.wait_for_selector("text=triangles")
        self.first = self.visitor.panel.settings, self.eye, self.target

    def restore(self):
        """Put controls and camera back to where they were at first."""
        chosen, eye, target = self.first
        self.visitor._flies.value = False
        for name, control in self.visitor.panel._controls.items():
            if control.value != getattr(chosen, name):
                control.value = getattr(chosen, name)
        if (self.eye, self.target) != (eye, target):
            camera = self.visitor.client.camera
            camera.position, camera.look_at = eye, target
        self.settled()
        assert self.visitor.panel.settings == chosen
        assert np.allclose([self.eye, self.target], [eye, target], atol=1e-3)

    def _hear(self, message):
        if message.type == "error":
            self.complaints.append(message.text)

    def until(self, condition):
        """Wait; Playwright must be let do its own work meanwhile."""
        end = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < end, f"it never came to be; {self.complaints}"
            self.tab.wait_for_timeout(50)

    @property
    def n_triangles(self):
        """As the page tells."""
        text = self.tab.locator("strong", has_text="triangles").inner_text()
        return int(text.removesuffix(" triangles").replace(" ", ""))

    def settled(self):
        """Return the number of triangles once it does not change any more.

        The camera must rest for some frames, as it glides on when the mouse is still; what it sees
        then must have been drawn; and the tab must tell so.
        """
        calm, seen = 0, None
        while calm < _CALM:
            self.tab.wait_for_timeout(50)
            now = pages._view(self.visitor.client.camera), self.visitor.panel.settings
            is_drawn = self.visitor._drawn == self.visitor._page.terrain.depends_on(*now)
            calm, seen = (calm + 1 if is_drawn and now == seen else 0), now
        self.until(lambda: self.n_triangles == self.visitor.picture.n_triangles)
        return self.n_triangles

    @property
    def eye(self):
        return tuple(self.visitor.client.camera.position)

    @property
    def target(self):
        return tuple(self.visitor.client.camera.look_at)

    def choose(self, label, option):
        self.tab.get_by_label(label, exact=True).first.click()
        self.tab.get_by_role("option", name=option).click()

    def push(self, key, times=1):
        """Push a key on the slider of the level of detail: the first that is to be seen."""
        slider = self.tab.get_by_role("slider").locator("visible=true").first
        slider.focus()
        before = self.visitor.panel.settings
        for _ in range(times):
            slider.press(key)
        self.until(lambda: self.visitor.panel.settings != before)

    def drag(self, right, down):
        """Turn the camera, at the lower left where nothing else is."""
        mouse, before = self.tab.mouse, self.eye
        mouse.move(150, 300)
        mouse.down()
        mouse.move(150 + right, 300 + down, steps=5)
        mouse.up()
        self.until(lambda: self.eye != before)

    def assert_clean(self):
        assert self.complaints == []
        ours = (self.home, self.home.replace("http", "ws"), "data:", f"blob:{self.home}")
        assert [url for url in self.asked if not (url + "/").startswith(ours)] == []


@pytest.fixture(scope="module")
def the_tab(browser, page):
    tab = Tab(browser, page)
    yield tab
    tab.tab.close()


@pytest.fixture
def tab(the_tab):
    """A tab as it is at first; one for all tests, as opening takes a second and a half."""
    yield the_tab
    the_tab.complaints.clear()
    the_tab.restore()


def shown(tab):
    """What the tab shows."""
    tab.settled()
    tab.tab.wait_for_timeout(300)  # two frames of a browser without a GPU
    return pixels(tab.tab)


def terrain_unlike(picture, other, by):
    """Share of the pixels that differ at the lower left, where the terrain is."""
    return share_unlike(picture[200:, :300], other[200:, :300], by)


def test_the_page_shows_the_terrain_with_nothing_from_outside(tab):
    picture = shown(tab)
    assert tab.n_triangles == tab.visitor.picture.n_triangles
    for node in tab.visitor._nodes:
        node.visible = False
    bare = seen(tab.tab, lambda bare: terrain_unlike(picture, bare, by=15) > 0.2)
    tab.assert_clean()
    assert terrain_unlike(picture, bare, by=15) > 0.2


def test_the_page_does_not_fade_in(browser, page):
    """viser does while it loads what lights are reflected in; we have no lights."""
    tab = browser.new_page()
    tab.add_init_script(
        """opacities = [];
        const look = () => {
            const now = document.querySelector("canvas[data-engine]")?.style.opacity;
            if (now && now !== opacities.at(-1)) opacities.push(now);
            requestAnimationFrame(look);
        };
        look();"""
    )
    tab.goto(page.address)
    tab.wait_for_function("opacities.at(-1) === '1'")
    opacities = tab.evaluate("opacities")
    tab.close()
    assert opacities in (["0.05", "1"], ["1"])


def test_the_page_shows_colours_as_they_are(browser):
    level = rtin.Grid(np.zeros((9, 9)), (10.0, 0.0, 0.0, 0.0, -10.0, 0.0))
    patches = [(0.7, 0.5, 0.2), (0.1, 0.3, 0.25), (0.9, 0.92, 0.93)]
    plates = [Terrain(level, painters={"one": painted_in(colour)}) for colour in patches]
    with pages.Page(plates[0], port=0) as page:
        tab = Tab(browser, page)
        for plate, colour in zip(plates, patches, strict=True):
            page.replace(plate)
            off = partial(off_in_the_middle, np.multiply(255.0, colour))
            assert off(seen(tab.tab, lambda picture, off=off: off(picture) < 2.0)) < 2.0
        tab.tab.close()


def off_in_the_middle(colour, picture):
    """How far the middle of a picture is from a colour."""
    return np.abs(np.median(picture[205:230, 240:290], axis=(0, 1)) - colour).max()


def test_the_slider_of_the_pixel_error_changes_the_triangles(tab):
    before = tab.settled()
    tab.push("ArrowRight", 8)  # from 1 to 3 pixels
    tab.until(lambda: tab.visitor.panel.settings.pixel_error == 3.0)
    after = tab.settled()
    tab.assert_clean()
    assert after < before / 2


def test_the_slider_of_the_tolerance_changes_the_triangles(tab):
    tab.choose("By", "tolerance")
    tab.until(lambda: tab.visitor.panel.settings.mode == "tolerance")
    before = tab.settled()
    tab.push("End")
    after = tab.settled()
    tab.assert_clean()
    assert after < before / 10
    grid = hills()
    assert tab.visitor.panel.settings.max_error == pytest.approx(0.1 * np.ptp(grid.heights))
    assert "in height" in tab.tab.inner_text("body")


def test_the_camera_changes_the_mesh(tab):
    before, glb, eye = tab.settled(), tab.visitor.picture.glb, tab.eye
    tab.tab.mouse.move(150, 300)
    for _ in range(8):
        tab.tab.mouse.wheel(0, -400)
    tab.until(lambda: tab.eye != eye)
    assert tab.settled() != before
    near = tab.visitor.picture.glb
    tab.drag(80, 30)
    tab.settled()
    tab.assert_clean()
    assert len({glb, near, tab.visitor.picture.glb}) == 3


def test_a_tolerance_is_not_drawn_again_for_another_camera(tab):
    tab.choose("By", "tolerance")
    tab.until(lambda: tab.visitor.panel.settings.mode == "tolerance")
    tab.settled()
    picture = tab.visitor.picture
    tab.drag(80, 30)
    tab.settled()
    assert tab.visitor.picture is picture


def test_the_wireframe_is_seen(tab):
    plain = shown(tab)
    tab.tab.get_by_label("Wireframe").click()
    tab.until(lambda: tab.visitor.panel.settings.wireframe)
    edges = seen(tab.tab, lambda edges: terrain_unlike(plain, edges, by=20) > 0.1)
    tab.assert_clean()
    assert terrain_unlike(plain, edges, by=20) > 0.1


def test_a_flight_moves_the_camera_until_it_is_ended(tab):
    flies = tab.tab.get_by_label("Fly round")
    flies.click()
    first = tab.visitor.client.camera.position.copy()
    tab.until(lambda: np.linalg.norm(tab.visitor.client.camera.position - first) > 0.1 * SIDE)
    flies.click()
    tab.until(lambda: tab.visitor._flight is None)
    tab.settled()
    there = tab.visitor.client.camera.position.copy()
    tab.tab.wait_for_timeout(300)
    tab.assert_clean()
    assert np.array_equal(tab.visitor.client.camera.position, there)


def test_two_tabs_are_independent(browser, own_page):
    tab, other = Tab(browser, own_page), Tab(browser, own_page)
    before = tab.settled()
    assert other.settled() == before
    other.push("ArrowRight", 8)
    other.until(lambda: other.visitor.panel.settings.pixel_error == 3.0)
    assert other.settled() < before / 2
    assert tab.settled() == before
    assert len(own_page.visitors) == 2
    other.tab.close()
    tab.until(lambda: list(own_page.visitors) == [tab.number])
    tab.push("ArrowRight", 4)
    assert tab.settled() < before
    tab.assert_clean()
    other.assert_clean()
    tab.tab.close()


def test_a_tab_that_is_closed_leaves_nothing_behind(browser, own_page, caplog):
    tab = Tab(browser, own_page)
    tab.tab.get_by_label("Fly round").click()
    tab.until(lambda: tab.visitor._flight is not None)
    left = [weakref.ref(tab.visitor), weakref.ref(tab.visitor.client)]
    left += [weakref.ref(tab.visitor._newest._task), weakref.ref(tab.visitor._flight)]
    tab.tab.close()
    tab.visitor = None
    until(lambda: not own_page.visitors)

    def is_gone():
        gc.collect()
        return all(ref() is None for ref in left)

    until(is_gone)
    assert caplog.messages == []  # asyncio tells of tasks that nobody has ended


def test_closing_a_page_that_is_looked_at_leaves_no_thread(browser, terrain):
    before = set(threading.enumerate())
    with pages.Page(terrain, port=0) as page:
        tab = Tab(browser, page)
        tab.tab.get_by_label("Fly round").click()
        tab.until(lambda: tab.visitor._flight is not None)
    until(lambda: set(threading.enumerate()) <= before)
    tab.tab.close()


def test_a_picture_that_fails_is_told_on_the_page_until_the_next_one(browser):
    def fail(mesh):
        raise ValueError("no *paint* is\nleft")

    painted = Terrain(hills((9, 9)), painters={"grey": painted_in((0.5, 0.5, 0.5)), "none": fail})
    with pages.Page(painted, port=0) as page:
        tab = Tab(browser, page)
        tab.choose("Colours", "none")
        tab.tab.wait_for_selector("text=no *paint* is left")
        tab.choose("Colours", "grey")
        tab.tab.wait_for_selector("text=triangles")
        tab.tab.close()


def test_another_terrain_takes_the_place_of_the_first(browser):
    coarse = Terrain(hills((17, 25), step=240.0))
    with pages.Page(coarse, port=0) as page:
        tab = Tab(browser, page)
        before = tab.settled()
        page.replace(Terrain(hills(), place=coarse.place, note="all 129 × 200 samples"))
        after = tab.settled()
        tab.tab.wait_for_selector("text=all 129 × 200 samples")
        tab.choose("By", "tolerance")
        tab.until(lambda: tab.visitor.panel.settings.mode == "tolerance")
        tab.settled()  # the tab shows the other slider
        tab.push("End")
        largest = pytest.approx(0.1 * np.ptp(hills().heights))
        tab.until(lambda: tab.visitor.panel.settings.max_error == largest)
        tab.tab.close()
    page.replace(coarse)  # nobody is there any more
    tab.assert_clean()
    assert after > 10 * before


# --- the command ----------------------------------------------------------------------------------


def test_the_command_shows_a_raster_until_ctrl_c(tmp_path, browser):
    np.save(tmp_path / "hills.npy", hills().heights)
    options = ("--port", 0, "--no-browser", "--max-triangles", 2000)
    with started("-m", "rtin", "view", tmp_path / "hills.npy", *options) as (process, port):
        for nonsense in (b"nonsense\r\n\r\n", b"GET / HTTP/1.1\r\nUpgrade: websocket\r\n\r\n", b""):
            with socket.create_connection(("127.0.0.1", port)) as client:
                client.sendall(nonsense)
                client.shutdown(socket.SHUT_WR)
                client.settimeout(10.0)
                client.recv(1000)
        tab = browser.new_page()
        tab.goto(f"http://127.0.0.1:{port}/")
        tab.wait_for_selector("text=triangles")
        status, complaints = interrupted(process)
        tab.close()
    assert status == 0
    assert "Traceback" not in complaints
    assert [word for word in ("viser", "handshake", "rror") if word in complaints] == []


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["missing.tif"], "missing.tif"), (["missing.ply"], "missing.ply"),
        (["text.tif"], "text.tif"), (["hills.npy", "--port", "70000"], "port"),
        (["hills.npy", "--max-error", "-1"], "--max-error must be zero or more, got -1"),
        (["hills.npy", "--pixel-error", "0"], "--pixel-error must be more than zero, got 0"),
        (["hills.npy", "--max-error", "1", "--max-triangles", "9"], "give one of"),
        (["hills.npy", "--pixel-error", "1", "--max-triangles", "9"], "give one of"),
    ],
)  # fmt: skip
def test_the_command_tells_in_a_line_what_it_cannot_show(tmp_path, arguments, reason):
    np.save(tmp_path / "hills.npy", hills((5, 6)).heights)
    (tmp_path / "text.tif").write_text("no raster")
    done = subprocess.run(
        [sys.executable, "-m", "rtin", "view", *arguments, "--no-browser"],
        cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert reason in done.stderr
    assert "Traceback" not in done.stderr


def test_the_command_tells_that_viser_is_missing(tmp_path):
    np.save(tmp_path / "hills.npy", hills((5, 6)).heights)
    program = "import sys; sys.modules['viser'] = None; from rtin.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "view", tmp_path / "hills.npy", "--no-browser"],
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert "pip install 'rtin[view]'" in done.stderr
    assert done.stderr.count("\n") == 1


def write_photo(path):
    """A picture without a place: its west half is red, its east half blue."""
    picture = np.full((20, 40, 3), 50, np.uint8)
    picture[:, :20, 0] = picture[:, 20:, 2] = 180
    Image.fromarray(picture).save(path)


def test_what_is_opened_has_its_colours(tmp_path):
    write_photo(tmp_path / "photo.png")
    np.save(tmp_path / "hills.npy", hills().heights)
    with Opening(tmp_path / "hills.npy") as opening:
        opened = opening.first()
    painters = scene.painters_of(opened, tmp_path / "photo.png")
    assert list(painters) == ["orthophoto", "hillshade", "height", "error"]
    shown = Terrain(opened.surface, painters=painters)
    colours = {}
    for name in painters:
        glb = shown.draw(OVERVIEW, Settings(colours=name)).glb
        positions, _, colours[name], _ = decoded(glb)
    assert len({values.tobytes() for values in colours.values()}) == 4
    west = positions[:, 0] < -5.0
    # A JPEG's red.
    assert np.allclose(as_shown(colours["orthophoto"][west]), (180, 50, 50), atol=4)


def test_a_mesh_that_is_opened_has_its_colours(tmp_path):
    rtin.write_mesh(rtin.coarsen(hills(), max_error=30.0), tmp_path / "hills.ply")
    with Opening(tmp_path / "hills.ply") as opening:
        painters = scene.painters_of(opening.first())
    assert list(painters) == ["hillshade", "height"]
