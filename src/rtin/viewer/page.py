"""A page in the browser that shows a terrain, with a level of detail that follows the camera.

Each client (a tab) has a scene, controls and a camera of its own. Nothing is queued: while a
picture is drawn, only the newest camera and settings are remembered. A picture goes to the one of
two nodes that isn't seen, which then takes the other one's place: viser doesn't show a GLB that
changes until it has been read.

Measured with viser 1.1 and Chromium without a GPU, for 100 000 triangles (2 MB): sending takes the
server 11 ms; drawing anew takes the page 25 ms for viser's plain mesh, which has one colour and
the lights' shade only, 37 ms for a GLB, with colours of its own, and 55 ms for two GLBs in turn.
"""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin._listening import address, listening
from rtin.viewer.cameras import overlook
from rtin.viewer.scene import HORIZON, SIDE, SKY, Picture, Settings, Terrain, View

try:
    import rich
    import viser

    from rtin.viewer._panel import Panel, told, told_failure
except ImportError as error:
    raise ImportError(f"the page needs viser ({error}): pip install 'rtin[view]'") from None

__all__ = ["Page", "Visitor", "run"]

_log = logging.getLogger("rtin.viewer")
_READING = 0.035  # seconds that a browser is given to read a GLB before it is to be seen
_ECHO = 0.5  # seconds to wait for a browser to move its camera
_ROUND = 40.0  # seconds for a flight round the terrain
_NEAR, _FAR = SIDE / 20_000.0, 20.0 * SIDE
_FURTHER = 4.0  # times as far as the first view: what is still seen, at least
_DRAWERS = 4  # threads that draw, for all clients


class Newest:
    """Does the same again and again, whenever asked, for what was asked last.

    Parameters
    ----------
    work : coroutine function without arguments
        It looks up itself what is wanted now. What it raises is logged, and told to ``on_failure``.
    """

    def __init__(
        self, work: Callable[[], Awaitable[None]], on_failure: Callable[[Exception], None]
    ) -> None:
        self._work, self._on_failure = work, on_failure
        self._wanted = asyncio.Event()
        self._task = asyncio.get_running_loop().create_task(self._go_on())

    def ask(self) -> None:
        """Have the work done, once more if it is being done; any number of times are one."""
        self._wanted.set()

    def end(self) -> None:
        """Do no more."""
        self._task.cancel()

    async def _go_on(self) -> None:
        while True:
            await self._wanted.wait()
            self._wanted.clear()
            try:
                await self._work()
            except Exception as error:
                _log.error("a picture failed: %s: %s", type(error).__name__, error)
                _log.debug("in full:", exc_info=error)
                self._on_failure(error)


class Visitor:
    """One client of a page: its scene, its controls and its camera.

    All its methods run in the server's event loop; only drawing has threads. So nothing is sent to
    a client that has gone.
    """

    def __init__(self, client: viser.ClientHandle, page: Page) -> None:
        self.client = client
        self.picture: Picture | None = None
        self._page = page
        self._drawn: tuple[Any, ...] | None = None
        terrain = page.terrain
        self.panel = Panel(
            client.gui,
            page.settings,
            height_range=terrain.height_range if terrain.has_levels else None,
            colours=tuple(terrain.painters),
            on_change=self.ask,
        )
        self._nodes: list[viser.GlbHandle] = []
        self._moved = asyncio.Event()
        self._newest = Newest(self._draw, self._tell)
        self._flight: asyncio.Task[None] | None = None
        self._flies = client.gui.add_checkbox(
            "Fly round", initial_value=False, hint="Until this is unchecked"
        )
        self._flies.on_update(self._fly_or_stay)
        client.camera.max_orbit_distance = page.reach / 2.0
        client.camera.on_update(self._follow)
        self.ask()

    def ask(self) -> None:
        """Have the newest view drawn."""
        self._newest.ask()

    def meet(self, terrain: Terrain) -> None:
        """Have another terrain drawn."""
        self.panel.reach(terrain.height_range)
        self.ask()

    def leave(self) -> None:
        """End whatever goes on for this client."""
        self._newest.end()
        if self._flight is not None:
            self._flight.cancel()

    async def _follow(self, _: viser.CameraHandle) -> None:
        self._moved.set()
        self.ask()

    async def _draw(self) -> None:
        started = time.perf_counter()
        terrain, view, settings = self._page.terrain, _view(self.client.camera), self.panel.settings
        wanted = terrain.depends_on(view, settings)
        if wanted == self._drawn:
            return
        draw = self._page.drawers.submit(terrain.draw, view, settings)
        picture = await asyncio.wrap_future(draw)
        await self._show(picture)
        self.picture, self._drawn = picture, wanted
        self.panel.show(told(picture, settings, time.perf_counter() - started, terrain.note))

    def _tell(self, error: Exception) -> None:
        """Say what failed until the next picture, though that be the one that is seen."""
        self._drawn = None
        self.panel.show(told_failure(error))

    async def _show(self, picture: Picture) -> None:
        """Put a picture into the node behind, then bring that one to the front."""
        scene = self.client.scene
        if len(self._nodes) < 2:
            options: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}
            name = f"/terrain {len(self._nodes)}"
            node = scene.add_glb(name, picture.glb, visible=False, **options)
            self._nodes.append(node)
        else:
            self._nodes.reverse()
            node = self._nodes[1]
            node.glb_data = picture.glb
        await asyncio.sleep(_READING)
        with self.client.atomic():
            for one in self._nodes:
                one.visible = one is node

    async def _fly_or_stay(self, _: object) -> None:
        if self._flight is not None:
            self._flight.cancel()
            self._flight = None
        if self._flies.value:
            self._flight = asyncio.get_running_loop().create_task(self._fly())

    def _highest(self) -> float:
        """Return how high the terrain's highest point is drawn."""
        terrain, exaggeration = self._page.terrain, self.panel.settings.exaggeration
        return float(terrain.place.into_scene(terrain.bounds[1], exaggeration)[2])

    async def _fly(self) -> None:
        """Move the camera along the path, each time once the browser has made the last move."""
        began, camera = time.monotonic(), self.client.camera
        while True:
            eye, target = _on_path((time.monotonic() - began) / _ROUND, self._highest())
            self._moved.clear()
            with self.client.atomic():
                camera.position, camera.look_at = eye, target
            with suppress(TimeoutError):
                async with asyncio.timeout(_ECHO):
                    await self._moved.wait()


def _view(camera: viser.CameraHandle) -> View:
    """Return where a client looks from; a window without any height is taken for a small one."""
    height, width = max(camera.image_height, 16), max(camera.image_width, 16)
    angle = min(max(math.degrees(camera.fov), 1.0), 170.0)
    eye, target, up = (
        tuple(map(float, point)) for point in (camera.position, camera.look_at, camera.up_direction)
    )
    return View(eye, target, up, angle, height, width / height)


def _on_path(
    turns: float, highest: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return eye and target on a round above the terrain, ``turns`` after its beginning."""
    angle = 2.0 * math.pi * turns - 0.5 * math.pi
    ahead = angle + 0.9
    radius, height = 0.3 * SIDE, highest + 0.06 * SIDE
    eye = (radius * math.cos(angle), radius * math.sin(angle), height)
    return eye, (radius * math.cos(ahead), radius * math.sin(ahead), 0.0)


class Page:
    """A server of the page; a context, which ends it.

    Parameters
    ----------
    terrain : Terrain
        What is seen at first.
    host, port : str, int
        Where to listen; port 0 is any free one.
    settings : Settings, optional
        What clients begin with.
    title : str
        Above the controls.

    Attributes
    ----------
    visitors : dict of Visitor
        By viser's numbers of clients.
    reach : float
        How far a camera sees, in units of the scene; it may go half as far away.

    Raises
    ------
    OSError
        If the port is taken or may not be used, or there is no such host.
    TypeError
        If ``terrain`` is something else.
    ValueError
        If the port is not one from 0 to 65535.
    """

    def __init__(
        self,
        terrain: Terrain,
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        settings: Settings | None = None,
        title: str = "rtin",
    ) -> None:
        if not isinstance(terrain, Terrain):
            raise TypeError(f"a Terrain is wanted, got {type(terrain).__name__}; Terrain(grid)")
        self.terrain = terrain
        self.settings = settings or Settings()
        self.visitors: dict[int, Visitor] = {}
        self.drawers = ThreadPoolExecutor(_DRAWERS, "rtin-draw")
        self._is_closed = False
        self._server = _started(host, port)
        self.address = address(host, self._server.get_port())
        self._server.gui.set_panel_label(title)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.scene.configure_default_lights(enabled=False, cast_shadow=False)
        self._server.scene.configure_environment_map(None)  # or it fades in while that loads
        self._server.scene.set_background_image(_sky(), format="png")
        self._look_over()
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._forget)

    def replace(self, terrain: Terrain) -> None:
        """Show another terrain to everybody; from any thread."""
        self.terrain = terrain
        with suppress(RuntimeError):  # of a loop that is closed: there is nobody to show it to
            self._server.get_event_loop().call_soon_threadsafe(self._present, terrain)

    def close(self) -> None:
        """Let everybody go, and end the server and its threads; a second time changes nothing."""
        if self._is_closed:
            return
        self._is_closed = True  # nobody who comes now is let in
        loop = self._server.get_event_loop()
        asyncio.run_coroutine_threadsafe(self._forget_all(), loop).result()
        with _quiet():
            self._server.stop()
        self.drawers.shutdown()

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _look_over(self) -> None:
        """Set the camera that clients begin with: from the south, above the whole terrain."""
        first = overlook(self.terrain, self.settings.exaggeration)
        self.reach = max(_FAR, _FURTHER * math.dist(first.eye, first.target))
        camera = self._server.initial_camera
        camera.position, camera.look_at = np.array(first.eye), np.array(first.target)
        camera.fov, camera.near, camera.far = math.radians(first.field_of_view), _NEAR, self.reach

    async def _welcome(self, client: viser.ClientHandle) -> None:
        if not self._is_closed:
            self.visitors[client.client_id] = Visitor(client, self)

    async def _forget(self, client: viser.ClientHandle) -> None:
        visitor = self.visitors.pop(client.client_id, None)
        if visitor is not None:
            visitor.leave()

    def _present(self, terrain: Terrain) -> None:
        for visitor in self.visitors.values():
            visitor.meet(terrain)

    async def _forget_all(self) -> None:
        while self.visitors:
            self.visitors.popitem()[1].leave()
        await asyncio.sleep(0)  # each of the tasks that were cancelled ends


def _sky() -> NDArray[np.uint8]:
    """Return a picture of the sky, shape (256, 2, 3)."""
    down = np.linspace(0.0, 1.0, 256)[:, np.newaxis, np.newaxis]
    colours = np.multiply(SKY, 1.0 - down) + np.multiply(HORIZON, down)
    return np.asarray(np.rint(np.repeat(colours, 2, axis=1)), np.uint8)


def _started(host: str, port: int) -> viser.ViserServer:
    """Return a server; viser itself would take the next port where one is taken."""
    with listening(host, port) as listener:
        free = listener.getsockname()[1]
    with _quiet():
        server = viser.ViserServer(host or "0.0.0.0", free, verbose=False)
    if server.get_port() != free:
        with _quiet():
            server.stop()
        raise OSError(f"cannot serve on port {free} of {host}: another program has just taken it")
    return server


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep viser, which prints through rich, from printing."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def run(page: Page, *, say: Callable[[str], None] = print) -> None:
    """Say where the page is, and wait until Ctrl-C.

    What clients do wrong is not logged from then on: the library that speaks to them would tell of
    each in a screenful.
    """
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    say(f"the terrain is at {page.address} (Ctrl-C ends it)")
    with suppress(KeyboardInterrupt):
        threading.Event().wait()
