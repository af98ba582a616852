"""A server of terrain tiles and of pages that show them.

What clients may do to it: ask for the same tile all at once (it is made once), ask for more than
can be made (refused with 503 until some are done), go away (what they waited for is dropped unless
it has begun), send or read slowly (they make way when connections get scarce), ask for paths
outside the tiles (there is nothing). Answers to errors are one line of JSON; the log has the cause.

Source of the protocol: quantized-mesh-1.0 as CesiumJS's ``CesiumTerrainProvider`` asks for it, and
RFC 9110 for validators, content codings and methods.
"""

from __future__ import annotations

import asyncio
import errno
import gzip
import hashlib
import json
import logging
import os
import re
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable, Hashable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, Protocol

from rtin._listening import address, listening
from rtin.schemes import SCHEMES, Scheme

try:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.datastructures import MutableHeaders
    from starlette.exceptions import HTTPException
    from starlette.middleware import Middleware
    from starlette.requests import Request
    from starlette.responses import JSONResponse, Response
    from starlette.routing import BaseRoute, Mount, Route
    from starlette.staticfiles import StaticFiles
    from starlette.types import ASGIApp, Message, Receive, Scope, Send
    from uvicorn.protocols.http.h11_impl import H11Protocol
except ImportError as error:
    raise ImportError(
        f"rtin.serve needs starlette and uvicorn ({error}): pip install 'rtin[tiles]'"
    ) from None

__all__ = ["FolderStore", "TileStore", "application", "run"]

_log = logging.getLogger("rtin.serve")
_PAGES = Path(__file__).parent / "pages"
_TERRAIN = "application/vnd.quantized-mesh"
# What of a folder is served, and as what; all else there is nobody's business.
_TYPES = {
    ".json": "application/json",
    ".glb": "model/gltf-binary",
    ".gltf": "model/gltf+json",
    ".subtree": "application/octet-stream",
    ".bin": "application/octet-stream",
    ".obj": "model/obj",
    ".ply": "application/octet-stream",
    ".png": "image/png",
    ".jpg": "image/jpeg",
}
_PAGE_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'"
)
# CesiumJS evaluates strings, compiles WebAssembly, starts workers, and decodes pictures from blobs.
_CESIUM_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-eval' blob:; worker-src 'self' blob:; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob:; "
    "img-src 'self' data: blob:; font-src 'self'; base-uri 'none'; form-action 'none'"
)
_TO_ALL = {
    "access-control-allow-origin": "*",
    "access-control-expose-headers": "ETag, Retry-After",
    "cross-origin-resource-policy": "cross-origin",
    "x-content-type-options": "nosniff",
}
_PREFLIGHT = {
    "access-control-allow-methods": "GET, HEAD, OPTIONS",
    "access-control-allow-headers": "*",
    "access-control-max-age": "86400",
    "allow": "GET, HEAD, OPTIONS",
}
_NUMBER = re.compile("0|[1-9][0-9]{0,9}")
_ENTRY_BYTES = 512  # what remembering a tile costs besides the tile
_MOST_CONNECTIONS = 512


class TileStore(Protocol):
    """Where tiles come from. Rows of tiles are TMS's here: they count from the south.

    Attributes
    ----------
    layer : dict
        layer.json as written; empty where there is no quantized-mesh tileset.
    scheme : Scheme
    minzoom, maxzoom : int
    """

    @property
    def layer(self) -> dict[str, Any]: ...  # noqa: D102
    @property
    def scheme(self) -> Scheme: ...  # noqa: D102
    @property
    def minzoom(self) -> int: ...  # noqa: D102
    @property
    def maxzoom(self) -> int: ...  # noqa: D102

    def terrain(self, zoom: int, x: int, y: int) -> bytes | None:
        """Return a tile, gzipped; None where there is none. Called from several threads."""
        ...

    def file(self, path: str) -> bytes | None:
        """Return another file of the tileset, by its path with slashes; None: there is none."""
        ...

    def health(self) -> dict[str, Any]:
        """Return what is worth knowing about the store, for JSON."""
        ...


# --- a folder of tiles --------------------------------------------------------------------------


class FolderStore:
    """The tiles that lie in a folder, as written by ``rtin tiles`` or by others.

    Files are read anew each time: tiles that change on disk change here. Only names that end as
    tiles do are served, never hidden ones, and no link leads out of the folder.

    Raises
    ------
    FileNotFoundError
        If there is neither a layer.json nor a tileset.json.
    ValueError
        If layer.json is not one of quantized-mesh tiles in EPSG:4326 or EPSG:3857.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder).resolve()
        layer = self.folder / "layer.json"
        if not layer.is_file() and not (self.folder / "tileset.json").is_file():
            raise FileNotFoundError(
                f"{folder} must have a layer.json or a tileset.json, as folders have that "
                "rtin tiles fills with --format terrain or 3dtiles"
            )
        self._stamp: tuple[int, int] | None = None
        self._layer: dict[str, Any] = {}
        self.scheme = _scheme_of(self.layer, layer)

    @property
    def layer(self) -> dict[str, Any]:
        """layer.json as it is now on disk."""
        path = self.folder / "layer.json"
        with suppress(FileNotFoundError):
            stat = path.stat()
            stamp = stat.st_mtime_ns, stat.st_size
            if stamp != self._stamp:
                self._layer, self._stamp = _layer_from(path), stamp
        return self._layer

    @property
    def minzoom(self) -> int:
        """The coarsest zoom."""
        return int(self.layer.get("minzoom", 0))

    @property
    def maxzoom(self) -> int:
        """The finest zoom; -1 where there are no quantized-mesh tiles."""
        layer = self.layer
        if "maxzoom" in layer:
            return int(layer["maxzoom"])
        return len(layer["available"]) - 1 if "available" in layer else 30 if layer else -1

    def terrain(self, zoom: int, x: int, y: int) -> bytes | None:
        """Return a tile's file, gzipped; None where there is none."""
        tile = self._read(f"{zoom}/{x}/{y}.terrain")
        if tile is None or tile.startswith(b"\x1f\x8b"):
            return tile
        return gzip.compress(tile, mtime=0)

    def file(self, path: str) -> bytes | None:
        """Return a file of the folder by its path with slashes; None where there is none."""
        return self._read(path) if PurePosixPath(path).suffix.lower() in _TYPES else None

    def health(self) -> dict[str, Any]:
        """Return that tiles come from a folder."""
        return {"store": "folder"}

    def _read(self, path: str) -> bytes | None:
        if any(part == "" or part.startswith(".") for part in path.split("/")):
            return None  # hidden, outside, absolute or not in its one form
        if any(letter in path for letter in "\\:\0"):
            return None
        try:
            found = (self.folder / path).resolve()
            inside = found.is_relative_to(self.folder) and found.is_file()
            return found.read_bytes() if inside else None
        except FileNotFoundError:
            return None
        except (RuntimeError, ValueError):
            return None  # links in a circle, or a name that no file can have
        except OSError as error:
            if error.errno in (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR):
                return None
            raise


def _layer_from(path: Path) -> dict[str, Any]:
    try:
        layer = json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} must be JSON: {error}") from None
    if not isinstance(layer, dict) or not str(layer.get("format", "")).startswith("quantized-mesh"):
        raise ValueError(f"{path} must be of quantized-mesh tiles: its format has to say so")
    return layer


def _scheme_of(layer: dict[str, Any], path: Path) -> Scheme:
    projection = layer.get("projection", "EPSG:4326")
    for scheme in SCHEMES.values():
        if scheme.crs == projection:
            return scheme
    raise ValueError(f"{path} must have the projection EPSG:4326 or EPSG:3857, got {projection!r}")


# --- making each tile once ----------------------------------------------------------------------


class _Answer(NamedTuple):
    body: bytes | None
    tag: str

    @property
    def size(self) -> int:
        return _ENTRY_BYTES + len(self.body or b"")


class _Busy(Exception):  # noqa: N818
    """More is asked for than can be waited for."""


@dataclass
class _Job:
    running: Future[_Answer]
    answer: asyncio.Future[_Answer]
    waiting: int = 0


class _Workshop:
    """Makes each thing once for all who ask at the same time, and remembers the latest ones.

    All methods are of the event loop; only ``make`` is called in other threads.
    """

    def __init__(self, workers: int, pending: int, cache_bytes: int) -> None:
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="rtin-tile")
        self._most_jobs, self._most_bytes = pending, cache_bytes
        self._jobs: dict[Hashable, _Job] = {}
        self._kept: OrderedDict[Hashable, _Answer] = OrderedDict()
        self._bytes = 0

    async def get(
        self,
        key: Hashable,
        make: Callable[[], bytes | None],
        gone: Callable[[], Awaitable[None]],
        *,
        keep: bool,
    ) -> _Answer | None:
        """Return what ``make`` makes, or None where ``gone`` ends before. Raises _Busy."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        job = self._jobs.get(key) or self._begin(key, make, keep)
        job.waiting += 1
        left: asyncio.Future[Any] = asyncio.ensure_future(gone())
        try:
            both: set[asyncio.Future[Any]] = {job.answer, left}
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            return job.answer.result() if job.answer.done() else None
        finally:
            left.cancel()
            job.waiting -= 1
            if not job.waiting and job.running.cancel():
                self._jobs.pop(key, None)

    def _begin(self, key: Hashable, make: Callable[[], bytes | None], keep: bool) -> _Job:
        if len(self._jobs) >= self._most_jobs:
            raise _Busy
        running = self._pool.submit(_answer_of, make)
        job = _Job(running, asyncio.wrap_future(running))
        job.answer.add_done_callback(lambda answer: self._end(key, job, answer, keep))
        self._jobs[key] = job
        return job

    def _end(self, key: Hashable, job: _Job, answer: asyncio.Future[_Answer], keep: bool) -> None:
        if self._jobs.get(key) is job:
            del self._jobs[key]
        if not answer.cancelled() and answer.exception() is None and keep:
            self._remember(key, answer.result())

    def _remember(self, key: Hashable, answer: _Answer) -> None:
        self._kept[key] = answer
        self._bytes += answer.size
        while self._bytes > self._most_bytes:
            self._bytes -= self._kept.popitem(last=False)[1].size

    def health(self) -> dict[str, int]:
        return {"pending": len(self._jobs), "kept": len(self._kept), "kept_bytes": self._bytes}

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)


def _answer_of(make: Callable[[], bytes | None]) -> _Answer:
    body = make()
    return _Answer(body, hashlib.blake2b(body or b"", digest_size=12).hexdigest())


# --- the application ----------------------------------------------------------------------------


def application(
    tiles: TileStore,
    *,
    cesium: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    pending: int = 64,
    cache_bytes: int = 256 << 20,
    max_age: int = 0,
) -> Starlette:
    """Return an ASGI application that serves ``tiles`` and pages that show them.

    Parameters
    ----------
    tiles : TileStore
    cesium : path, optional
        CesiumJS's npm package, its folder Build/Cesium, or a folder with node_modules. By default
        it is looked for in the working folder; without it one page says how to get it.
    workers : int, optional
        Threads that make tiles; by default one for each processor, at most 4.
    pending : int
        Tiles that may be waited for. When there are more, new ones are refused with status 503.
    cache_bytes : int
        Of tiles to remember. Those of a FolderStore are not: the disk has them.
    max_age : int
        Seconds for which clients need not ask again; 0: they ask each time, and get 304 where
        nothing has changed.

    Raises
    ------
    FileNotFoundError
        If there is no CesiumJS in ``cesium``.
    ValueError
        If ``workers``, ``pending``, ``cache_bytes`` or ``max_age`` is out of range.
    """
    workers = min(4, os.cpu_count() or 1) if workers is None else workers
    for name, value, least in (
        ("workers", workers, 1), ("pending", pending, 1),
        ("cache_bytes", cache_bytes, 0), ("max_age", max_age, 0),
    ):  # fmt: skip
        if value < least:
            raise ValueError(f"{name} must be {least} or more, got {value}")
    workshop = _Workshop(workers, pending, cache_bytes)
    age = f"public, max-age={max_age}" if max_age else "no-cache"
    routes = _Tiles(tiles, workshop, age).routes()

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        workshop.close()

    return Starlette(
        routes=[*_page_routes(), *_cesium_routes(cesium), *routes],
        middleware=[Middleware(_Guard)],
        exception_handlers={HTTPException: _refusal},
        lifespan=lifespan,
    )


class _Tiles:
    """The routes that answer from a store."""

    def __init__(self, tiles: TileStore, workshop: _Workshop, age: str) -> None:
        self._tiles, self._workshop, self._age = tiles, workshop, age
        self._keep = not isinstance(tiles, FolderStore)

    def routes(self) -> list[BaseRoute]:
        return [
            Route("/layer.json", self.layer),
            Route("/health", self.health),
            Route("/{zoom}/{x}/{y}.terrain", self.terrain),
            Route("/{path:path}", self.file),
        ]

    async def layer(self, request: Request) -> Response:
        layer = self._tiles.layer
        if not layer:
            raise HTTPException(404, "there are no quantized-mesh tiles here")
        body = json.dumps(layer).encode()
        return self._respond(request, _answer_of(lambda: body), "application/json")

    async def health(self, _: Request) -> Response:
        terrain = {"terrain": bool(self._tiles.layer)}
        states = {"status": "ok", **terrain, **self._tiles.health(), **self._workshop.health()}
        return JSONResponse(states, headers={"cache-control": "no-store"})

    async def terrain(self, request: Request) -> Response:
        zoom, x, y = (_number(request.path_params[name]) for name in ("zoom", "x", "y"))
        if not self._has_place(zoom, x, y):
            raise HTTPException(404, "there is no such tile")
        answer = await self._get(
            request, (zoom, x, y), lambda: self._tiles.terrain(zoom, x, y), keep=self._keep
        )
        if "gzip" in _codings(request):
            return self._respond(request, answer, _TERRAIN, coding="gzip")
        plain = await asyncio.to_thread(_decompressed, answer)
        return self._respond(request, plain, _TERRAIN, coding="")

    async def file(self, request: Request) -> Response:
        path = request.path_params["path"]
        kind = _TYPES.get(PurePosixPath(path).suffix.lower())
        if kind is None:
            raise HTTPException(404, "there is no such file")
        answer = await self._get(request, path, lambda: self._tiles.file(path), keep=False)
        return self._respond(request, answer, kind)

    def _has_place(self, zoom: int, x: int, y: int) -> bool:
        if not max(0, self._tiles.minzoom) <= zoom <= self._tiles.maxzoom:
            return False
        rows, cols = self._tiles.scheme.tile_shape(zoom)
        return 0 <= x < cols and 0 <= y < rows

    async def _get(
        self, request: Request, key: Hashable, make: Callable[[], bytes | None], *, keep: bool
    ) -> _Answer:
        try:
            answer = await self._workshop.get(key, make, lambda: _disconnected(request), keep=keep)
        except _Busy:
            later = {"retry-after": "1"}
            raise HTTPException(503, "too many tiles are asked for; try again", later) from None
        if answer is None:
            raise HTTPException(499, "the client has gone")
        if answer.body is None:
            raise HTTPException(404, "there is no such tile or file")
        return answer

    def _respond(
        self, request: Request, answer: _Answer, kind: str, *, coding: str | None = None
    ) -> Response:
        """Return the answer, or 304. ``coding`` is None where it does not depend on the client."""
        tag = f'"{answer.tag}"'
        headers = {"etag": tag, "cache-control": self._age}
        if coding is not None:
            headers["vary"] = "Accept-Encoding"
        if _knows(request.headers.get("if-none-match", ""), tag):
            return Response(status_code=304, headers=headers)
        if coding:
            headers["content-encoding"] = coding
        return Response(answer.body, headers=headers, media_type=kind)


def _number(text: str) -> int:
    """Return a number in its one form; -1 for any other text."""
    return int(text) if _NUMBER.fullmatch(text) else -1


def _knows(if_none_match: str, tag: str) -> bool:
    known = [one.strip().removeprefix("W/") for one in if_none_match.split(",")]
    return tag in known or known == ["*"]


def _codings(request: Request) -> list[str]:
    """Return the content codings that the client takes: those with a weight above zero."""
    named = (one.partition(";") for one in request.headers.get("accept-encoding", "").split(","))
    weights = {name.strip().lower(): re.sub("[ =]|q", "", weight) for name, _, weight in named}
    return [name for name, weight in weights.items() if not re.fullmatch(r"0(\.0*)?", weight)]


def _decompressed(answer: _Answer) -> _Answer:
    """Return the answer without gzip. Other bytes, other tag."""
    assert answer.body is not None, "asked of tiles that there are"
    return _Answer(gzip.decompress(answer.body), answer.tag + "-plain")


async def _disconnected(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def _refusal(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException), "it is registered for these"
    return _one_line_error(error.status_code, error.detail, error.headers)


def _one_line_error(
    status: int, detail: str, headers: Mapping[str, str] | None = None
) -> JSONResponse:
    headers = {"cache-control": "no-cache", **(headers or {})}
    return JSONResponse({"error": detail}, status_code=status, headers=headers)


class _Guard:
    """Answers preflights, lets every origin in, and turns what fails into one line of JSON."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = False

        async def send_with_headers(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                MutableHeaders(scope=message).update(_TO_ALL)
            await send(message)

        if scope["method"] == "OPTIONS":
            await Response(status_code=204, headers=_PREFLIGHT)(scope, receive, send_with_headers)
            return
        try:
            await self._app(scope, receive, send_with_headers)
        except Exception as error:
            _log.error("%s failed: %s: %s", scope["path"], type(error).__name__, error)
            _log.debug("in full:", exc_info=error)
            if begun:
                raise
            failure = _one_line_error(500, "the server failed; its log says why")
            await failure(scope, receive, send_with_headers)


# --- pages --------------------------------------------------------------------------------------


def _page_routes() -> list[BaseRoute]:
    """Return a route for each file of the package's folder of pages; index.html is also ``/``."""
    files = {page.name: page for page in sorted(_PAGES.iterdir()) if page.suffix in _PAGE_TYPES}
    routes: list[BaseRoute] = [Route("/", _page(files["index.html"]))]
    for name, page in files.items():
        folder = "" if page.suffix == ".html" else "pages/"
        routes.append(Route(f"/{folder}{name}", _page(page)))
    return routes


def _page(path: Path) -> Callable[[Request], Awaitable[Response]]:
    policy = _CESIUM_POLICY if path.stem == "cesium" else _POLICY
    headers = {"cache-control": "no-cache", "content-security-policy": policy}
    body, kind = path.read_bytes(), _PAGE_TYPES[path.suffix]

    async def respond(_: Request) -> Response:
        return Response(body, headers=headers, media_type=kind)

    return respond


def _cesium_routes(cesium: str | os.PathLike[str] | None) -> list[BaseRoute]:
    found = _find_cesium(Path(cesium or "."))
    if found:
        return [Mount("/cesium", StaticFiles(directory=found))]
    if cesium is None:
        return []
    raise FileNotFoundError(
        f"{os.fspath(cesium)} must hold CesiumJS: npm install --prefix {os.fspath(cesium)} cesium"
    )


def _find_cesium(folder: Path) -> Path | None:
    places = (folder, folder / "Build/Cesium", folder / "node_modules/cesium/Build/Cesium")
    return next((place for place in places if (place / "Cesium.js").is_file()), None)


# --- running it ---------------------------------------------------------------------------------


class _Connection(H11Protocol):
    """A connection that makes way when there are too many and it does nothing.

    A client that sends its request byte by byte, or does not read its answer, holds a connection;
    the one that has done so the longest is ended for a new one. Those that wait for a tile are not.
    """

    waiting_since = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        if len(self.connections) >= _MOST_CONNECTIONS:
            self._end_the_longest_waiting()
        self.waiting_since = self.loop.time()
        super().connection_made(transport)

    def on_response_complete(self) -> None:
        self.waiting_since = self.loop.time()
        super().on_response_complete()

    @property
    def _working(self) -> bool:
        unanswered = self.cycle is not None and not self.cycle.response_complete
        return unanswered and not self.flow.write_paused

    def _end_the_longest_waiting(self) -> None:
        others = [one for one in self.connections if isinstance(one, _Connection)]
        waiting = [one for one in others if not one._working]
        if waiting:
            longest = min(waiting, key=lambda one: one.waiting_since)
            self.connections.discard(longest)
            longest.transport.abort()


def run(
    tiles: TileStore,
    host: str = "127.0.0.1",
    port: int = 8080,
    *,
    say: Callable[[str], None] = print,
    **options: Any,  # noqa: ANN401
) -> None:
    """Serve ``tiles`` until Ctrl-C, then return.

    ``say`` is told the addresses once connections are taken; ``options`` are those of
    ``application``. Port 0 is any free one.

    Raises
    ------
    OSError
        If the port is taken or may not be used, or there is no such host.
    ValueError
        If the port is not one from 0 to 65535, or an option of ``application`` is out of range.
    """
    server = uvicorn.Server(_config(application(tiles, **options)))
    with listening(host, port) as listener:
        home = address(host, listener.getsockname()[1])
        say(f"serving {home} (Ctrl-C ends it)")
        say(f"  {home}viewer.html  the terrain, without anything from outside")
        say(f"  {home}cesium.html  the terrain on CesiumJS's globe")
        with suppress(KeyboardInterrupt):
            server.run(sockets=[listener])


def _config(app: Starlette) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        http=_Connection,
        ws="none",
        log_config=None,
        log_level="critical",  # of clients' mistakes: ours are in our own log
        access_log=False,
        server_header=False,
        limit_concurrency=_MOST_CONNECTIONS + 64,
        h11_max_incomplete_event_size=16 << 10,
        timeout_keep_alive=20,
        timeout_graceful_shutdown=2,
    )
