"""The server of tiles, asked over sockets as by good and by bad clients."""

import concurrent.futures
import gzip
import http.client
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

from islands import write_island

pytest.importorskip("uvicorn")

import uvicorn

from rtin import serve
from rtin._listening import listening
from rtin.schemes import SCHEMES

TILE = "0/0/0.terrain"


class FakeStore:
    """Makes tiles that say which they are, as soon as it is let."""

    scheme = SCHEMES["geographic"]
    minzoom, maxzoom = 0, 14

    def __init__(self):
        self.layer = {"format": "quantized-mesh-1.0", "minzoom": 0, "maxzoom": 14}
        self.made, self.let, self.lock = [], threading.Event(), threading.Lock()
        self.let.set()

    def terrain(self, zoom, x, y):
        with self.lock:
            self.made.append((zoom, x, y))
        assert self.let.wait(20)
        if x == 13:
            raise RuntimeError("the disk\nhas gone to /secret")
        return None if x == 7 else gzip.compress(b"%d %d %d" % (zoom, x, y) * 100, mtime=0)

    def file(self, path):
        return None

    def health(self):
        return {"store": "fake"}


@contextmanager
def serving(tiles, **options):
    """Yield the port of a server in a thread, with the settings that ``run`` uses."""
    server = uvicorn.Server(serve._config(serve.application(tiles, **options)))
    with listening("127.0.0.1", 0) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            server.should_exit = True
            thread.join()


@pytest.fixture
def store():
    return FakeStore()


@pytest.fixture
def port(store):
    with serving(store) as port:
        yield port
        store.let.set()


def write_tiles(folder, zooms):
    """A folder as rtin tiles fills it; to a server a tile is any bytes in gzip."""
    for zoom in zooms:
        for x in range(2):
            path = folder / f"{zoom}/{x}/0.terrain"
            path.parent.mkdir(parents=True)
            path.write_bytes(gzip.compress(path.as_posix().encode(), mtime=0))
    layer = {"format": "quantized-mesh-1.0", "projection": "EPSG:4326", "maxzoom": zooms[-1]}
    (folder / "layer.json").write_text(json.dumps(layer))
    return folder


@pytest.fixture(scope="module")
def folder_of_tiles(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")
    return write_tiles(folder / "tiles", range(4))


def ask(port, path, method="GET", **headers):
    """Return status, headers and body of one request; the path goes out as it is."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request(
        method, "/" + path, headers={k.replace("_", "-"): v for k, v in headers.items()}
    )
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response.status, {k.lower(): v for k, v in response.headers.items()}, body


def until(condition):
    """Wait for what happens in another thread, at most as long as it takes to see that it won't."""
    end = time.monotonic() + 20
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


# --- what a viewer asks for -----------------------------------------------------------------------


def test_a_tile_comes_gzipped_to_who_takes_gzip_and_plain_to_others(port):
    status, headers, packed = ask(
        port, "3/4/5.terrain?v=1.0.0", accept_encoding="gzip, deflate, br"
    )
    assert (status, headers["content-encoding"]) == (200, "gzip")
    assert gzip.decompress(packed) == b"3 4 5" * 100
    for others in ({}, {"accept_encoding": "gzip;q=0"}, {"accept_encoding": "gzip; q=0.000, br"}):
        status, plain_headers, plain = ask(port, "3/4/5.terrain", **others)
        assert (status, plain) == (200, b"3 4 5" * 100)
        assert "content-encoding" not in plain_headers
    assert headers["vary"] == plain_headers["vary"] == "Accept-Encoding"
    assert headers["etag"] != plain_headers["etag"]


def test_a_tile_has_the_type_that_cesium_asks_for(port):
    wanted = (
        "application/vnd.quantized-mesh;extensions=octvertexnormals,application/octet-stream;q=0.9"
    )
    assert ask(port, TILE, accept=wanted)[1]["content-type"] == "application/vnd.quantized-mesh"


@pytest.mark.parametrize("path", [TILE, "layer.json"])
def test_what_has_not_changed_is_not_sent_again(port, path):
    _, headers, _ = ask(port, path, accept_encoding="gzip")
    for known in (headers["etag"], f'"other", W/{headers["etag"]}', "*"):
        status, again, body = ask(port, path, accept_encoding="gzip", if_none_match=known)
        assert (status, body, again["etag"]) == (304, b"", headers["etag"])
    assert ask(port, path, accept_encoding="gzip", if_none_match='"other"')[0] == 200


@pytest.mark.parametrize("path", [TILE, "layer.json", "viewer.html", "health"])
def test_head_says_what_get_would(port, path):
    got, said = ask(port, path), ask(port, path, "HEAD")
    assert (got[0], said[0], said[2]) == (200, 200, b"")
    assert said[1]["content-length"] == str(len(got[2]))


def test_caches_ask_each_time_unless_told_otherwise(store, port):
    assert ask(port, TILE)[1]["cache-control"] == "no-cache"
    with serving(store, max_age=60) as patient:
        assert ask(patient, TILE)[1]["cache-control"] == "public, max-age=60"


@pytest.mark.parametrize("path", [TILE, "layer.json", "health", "", "nothing", "0/13/0.terrain"])
def test_every_origin_may_read_every_answer(port, path):
    assert ask(port, path, origin="https://a.example")[1]["access-control-allow-origin"] == "*"
    status, headers, _ = ask(port, path, "OPTIONS", access_control_request_method="GET")
    assert (status, headers["access-control-allow-methods"]) == (204, "GET, HEAD, OPTIONS")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_nothing_can_be_written(port, method):
    status, headers, body = ask(port, TILE, method)
    assert status == 405
    assert "GET" in headers["allow"]
    assert_one_line(body)


def test_health_tells_of_the_store_and_of_the_tiles_kept(port):
    ask(port, TILE)
    health = json.loads(ask(port, "health")[2])
    assert health["status"] == "ok"
    assert health["terrain"] is True
    assert (health["store"], health["pending"], health["kept"]) == ("fake", 0, 1)


# --- what is refused ------------------------------------------------------------------------------


def assert_one_line(body):
    assert b"\n" not in body
    assert list(json.loads(body)) == ["error"]


@pytest.mark.parametrize(
    "path",
    [
        "15/0/0.terrain", "-1/0/0.terrain", f"{10**30}/0/0.terrain", "0/2/0.terrain",
        "0/0/1.terrain", f"3/{10**30}/0.terrain", f"3/0/{'9' * 5000}.terrain", "3/-1/0.terrain",
        "3/0x1/0.terrain", "3/1.0/0.terrain", "3/1e0/0.terrain", "3/%201/0.terrain",
        "3/+1/0.terrain",
        "03/1/1.terrain", "3/١/1.terrain".encode().decode("latin-1"), "a/b/c.terrain", "//.terrain",
        "3/1/.terrain", "3/1/1.terrain/", "3/1/1.Terrain", "3/%00/1.terrain", "3/nan/1.terrain",
    ],
)  # fmt: skip
def test_a_tile_that_cannot_be_is_refused_without_work(store, port, path):
    status, _, body = ask(port, "".join(c if ord(c) < 128 else f"%{ord(c):02X}" for c in path))
    assert status == 404
    assert_one_line(body)
    assert store.made == []


def test_a_tile_that_the_store_has_not_is_not_found_and_not_looked_for_again(store, port):
    for _ in range(3):
        status, _, body = ask(port, "5/7/0.terrain")
        assert status == 404
        assert_one_line(body)
    assert store.made == [(5, 7, 0)]


def test_a_failure_is_one_line_to_the_client_and_one_to_the_log(port, caplog):
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            status, _, body = ask(port, "5/13/0.terrain")
            assert status == 500
            assert_one_line(body)
            assert b"secret" not in body
    assert [record.name for record in caplog.records] == ["rtin.serve"] * 2
    assert "/5/13/0.terrain" in caplog.records[0].getMessage()
    assert "has gone" in caplog.records[0].getMessage()
    assert ask(port, TILE)[0] == 200


@pytest.mark.parametrize(
    "junk",
    [
        b"GET / HTTP/9.9\r\n\r\n", b"\x16\x03\x01\x02\x00", b"GET /" + b"a" * 100_000,
        b"GET / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nHost: a\r\nContent-Length: -1\r\n\r\n",
        b"GET \x00 HTTP/1.1\r\nHost: a\r\n\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"OPTIONS * HTTP/1.1\r\nHost: a\r\n\r\n", b"GET http:// HTTP/1.1\r\nHost: a\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n",
    ],
)  # fmt: skip
def test_junk_ends_no_server(port, junk):
    with socket.create_connection(("127.0.0.1", port), timeout=20) as client:
        client.sendall(junk)
        client.shutdown(socket.SHUT_WR)
        answer = client.recv(1 << 16)
    assert b"Traceback" not in answer
    assert ask(port, TILE)[0] == 200


# --- crowds ---------------------------------------------------------------------------------------


def test_tiles_that_many_ask_for_at_once_are_made_once(store, port):
    store.let.clear()
    paths = [f"6/{i % 20 + 20}/3.terrain" for i in range(200)]
    with concurrent.futures.ThreadPoolExecutor(200) as crowd:
        answers = [crowd.submit(ask, port, path) for path in paths]
        until(lambda: json.loads(ask(port, "health")[2])["pending"] == 20)
        store.let.set()
        results = [answer.result() for answer in answers]
    assert [status for status, _, _ in results] == [200] * 200
    for path, (_, _, body) in zip(paths, results, strict=True):
        assert body == b"6 %s 3" % path.split("/")[1].encode() * 100
    assert sorted(store.made) == [(6, x, 3) for x in range(20, 40)]


def test_more_tiles_than_can_be_waited_for_are_refused_for_now(store):
    store.let.clear()
    with (
        serving(store, workers=1, pending=3) as port,
        concurrent.futures.ThreadPoolExecutor(3) as crowd,
    ):
        held = [crowd.submit(ask, port, f"6/{x}/3.terrain") for x in (20, 21, 22)]
        until(lambda: json.loads(ask(port, "health")[2])["pending"] == 3)
        status, headers, body = ask(port, "6/23/3.terrain")
        assert (status, headers["retry-after"]) == (503, "1")
        assert_one_line(body)
        assert ask(port, "viewer.html")[0] == 200
        store.let.set()
        assert [one.result()[0] for one in held] == [200] * 3
        assert ask(port, "6/23/3.terrain")[0] == 200


def test_who_goes_away_frees_the_place(store):
    store.let.clear()
    with serving(store, workers=1, pending=2) as port:
        begun = begin(port, "6/20/3.terrain")
        until(lambda: store.made == [(6, 20, 3)])
        queued = begin(port, "6/21/3.terrain")
        until(lambda: json.loads(ask(port, "health")[2])["pending"] == 2)
        queued.close()
        until(lambda: json.loads(ask(port, "health")[2])["pending"] == 1)
        begun.close()
        other = begin(port, "6/22/3.terrain")
        store.let.set()
        assert other.recv(15) == b"HTTP/1.1 200 OK"
        other.close()
    # the one begun was finished, the one that nobody waits for was not
    assert store.made == [(6, 20, 3), (6, 22, 3)]


def test_a_tile_that_one_of_two_waits_on_for_is_still_made(store):
    store.let.clear()
    with serving(store, workers=1) as port:
        first = begin(port, "6/20/3.terrain")
        until(lambda: store.made)
        leaving, staying = begin(port, "6/21/3.terrain"), begin(port, "6/21/3.terrain")
        time.sleep(0.2)
        leaving.close()
        time.sleep(0.2)
        store.let.set()
        assert staying.recv(15) == b"HTTP/1.1 200 OK"
        first.close()
        staying.close()


def begin(port, path):
    """Ask without waiting for the answer."""
    client = socket.create_connection(("127.0.0.1", port), timeout=20)
    client.sendall(f"GET /{path} HTTP/1.1\r\nHost: a\r\n\r\n".encode())
    return client


def test_the_cache_stays_within_its_bytes(store):
    with serving(store, cache_bytes=5000) as port:
        for x in range(20, 60):
            ask(port, f"6/{x}/3.terrain")
        kept = json.loads(ask(port, "health")[2])
        assert 0 < kept["kept_bytes"] <= 5000
        made = len(store.made)
        ask(port, "6/59/3.terrain")
        assert len(store.made) == made
        ask(port, "6/20/3.terrain")
        assert len(store.made) == made + 1


def test_slow_clients_make_way_for_others(store, monkeypatch):
    monkeypatch.setattr(serve, "_MOST_CONNECTIONS", 8)
    with serving(store) as port:
        slow = [socket.create_connection(("127.0.0.1", port), timeout=20) for _ in range(30)]
        for _ in range(3):
            for client in slow:
                drip(client)
            assert ask(port, TILE)[0] == 200
            assert ask(port, "viewer.html")[0] == 200
        assert [ended(client) for client in slow[:20]] == [True] * 20
        assert not ended(slow[-1])
        for client in slow:
            client.close()


def drip(client):
    try:
        client.sendall(b"G")
    except OSError:
        return  # it had to make way


def ended(client):
    client.setblocking(False)
    try:
        return client.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def test_who_waits_for_a_tile_need_not_make_way(store, monkeypatch):
    monkeypatch.setattr(serve, "_MOST_CONNECTIONS", 4)
    store.let.clear()
    with serving(store) as port:
        waiting = begin(port, TILE)
        until(lambda: store.made)
        idle = [socket.create_connection(("127.0.0.1", port), timeout=20) for _ in range(20)]
        assert ask(port, "viewer.html")[0] == 200
        store.let.set()
        assert waiting.recv(15) == b"HTTP/1.1 200 OK"
        for client in [waiting, *idle]:
            client.close()


def test_who_does_not_read_holds_up_nobody(tmp_path, monkeypatch):
    monkeypatch.setattr(serve, "_MOST_CONNECTIONS", 8)
    (tmp_path / "tileset.json").write_text("{}")
    (tmp_path / "large.glb").write_bytes(bytes(64 << 20))  # more than the kernel takes off us
    with serving(serve.FolderStore(tmp_path)) as port:
        greedy = [begin(port, "large.glb") for _ in range(6)]
        for client in greedy:
            assert client.recv(15) == b"HTTP/1.1 200 OK"  # and no more
        for _ in range(30):
            assert ask(port, "tileset.json")[0] == 200
        later = [socket.create_connection(("127.0.0.1", port), timeout=20) for _ in range(20)]
        assert ask(port, "tileset.json")[0] == 200
        for client in [*greedy, *later]:
            client.close()


# --- folders --------------------------------------------------------------------------------------


def test_a_folder_is_served_byte_for_byte(folder_of_tiles):
    with serving(serve.FolderStore(folder_of_tiles)) as port:
        for tile in folder_of_tiles.rglob("*.terrain"):
            path = tile.relative_to(folder_of_tiles).as_posix()
            assert ask(port, path, accept_encoding="gzip")[2] == tile.read_bytes()
        assert json.loads(ask(port, "layer.json")[2]) == json.loads(
            (folder_of_tiles / "layer.json").read_text()
        )
        assert ask(port, "3/5/0.terrain")[0] == 404


def test_tiles_that_change_in_the_folder_change_for_clients(tmp_path):
    write_tiles(tmp_path, range(1))
    with serving(serve.FolderStore(tmp_path)) as port:
        before = ask(port, TILE)[1]["etag"]
        (tmp_path / TILE).write_bytes(gzip.compress(b"another", mtime=0))
        assert ask(port, TILE, if_none_match=before)[2] == b"another"
        layer = json.loads((tmp_path / "layer.json").read_text())
        (tmp_path / "layer.json").write_text(json.dumps(layer | {"name": "New name"}))
        assert json.loads(ask(port, "layer.json")[2])["name"] == "New name"


def test_tiles_that_lie_there_without_gzip_are_served_too(tmp_path):
    write_tiles(tmp_path, range(1))
    (tmp_path / TILE).write_bytes(b"plain")
    with serving(serve.FolderStore(tmp_path)) as port:
        assert ask(port, TILE)[2] == b"plain"
        assert gzip.decompress(ask(port, TILE, accept_encoding="gzip")[2]) == b"plain"


def test_3d_tiles_have_the_types_that_viewers_want(tmp_path):
    files = {
        "tileset.json": "application/json", "a/b.glb": "model/gltf-binary",
        "subtrees/0.0.0.subtree": "application/octet-stream",
    }  # fmt: skip
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    with serving(serve.FolderStore(tmp_path)) as port:
        for name, kind in files.items():
            status, headers, body = ask(port, name)
            assert (status, headers["content-type"], body) == (200, kind, name.encode())
            assert ask(port, name, if_none_match=headers["etag"])[0] == 304
        assert ask(port, "layer.json")[0] == 404
        assert ask(port, TILE)[0] == 404


OUTSIDE = [
    "../secret.json", "a/../../secret.json", "%2e%2e/secret.json", "%2e%2e%2fsecret.json",
    "..%5csecret.json", "a/%2e%2e/%2e%2e/secret.json", "/secret.json", "//secret.json",
    "%2fsecret.json", "secret.json%00.json", "..%00/secret.json", "%252e%252e/secret.json",
    "....//secret.json", "..;/secret.json", "link.json", "folder/secret.json", "loop.json",
    "c:/secret.json", "./layer.json", "a/./b.json", ".hidden.json", ".rtin/manifest.json",
    "manifest.sqlite", "secret.txt", "a.json/", "%ff%fe.json", "a" * 5000 + ".json",
    "0/..%2f..%2f/secret.terrain", "cesium/../../secret.json", "pages/../../serve.py",
    "pages/%2e%2e/serve.py", "pipe.json",
]  # fmt: skip


@pytest.mark.parametrize("path", OUTSIDE)
def test_no_path_leads_out_of_the_folder(tmp_path, path):
    inside = tmp_path / "tiles"
    (inside / ".rtin").mkdir(parents=True)
    (inside / "layer.json").write_text('{"format": "quantized-mesh-1.0"}')
    for secret in (
        tmp_path / "secret.json", tmp_path / "secret.terrain", inside / ".hidden.json",
        inside / ".rtin/manifest.json", inside / "manifest.sqlite", inside / "secret.txt",
    ):  # fmt: skip
        secret.write_text("secret")
    (inside / "link.json").symlink_to(tmp_path / "secret.json")
    (inside / "folder").symlink_to(tmp_path)
    (inside / "loop.json").symlink_to(inside / "loop.json")
    os.mkfifo(inside / "pipe.json")
    with serving(serve.FolderStore(inside)) as port:
        status, _, body = ask(port, path)
        assert status == 404
        assert b"secret" not in body.replace(b"no such", b"")
        assert ask(port, "layer.json")[0] == 200


def test_links_within_the_folder_are_followed(tmp_path):
    (tmp_path / "tileset.json").write_text("{}")
    (tmp_path / "same.json").symlink_to("tileset.json")
    with serving(serve.FolderStore(tmp_path)) as port:
        assert ask(port, "same.json")[2] == b"{}"


@pytest.mark.parametrize(
    ("layer", "message"),
    [
        ("{", "must be JSON"), ("[]", "must be of quantized-mesh tiles"),
        ('{"format": "heightmap-1.0"}', "must be of quantized-mesh tiles"),
        ('{"format": "quantized-mesh-1.0", "projection": "EPSG:2056"}', "EPSG:4326 or EPSG:3857"),
    ],
)  # fmt: skip
def test_a_folder_of_something_else_is_refused(tmp_path, layer, message):
    (tmp_path / "layer.json").write_text(layer)
    with pytest.raises(ValueError, match=message):
        serve.FolderStore(tmp_path)


@pytest.mark.parametrize("name", ["", "missing"])
def test_a_folder_without_tiles_is_refused(tmp_path, name):
    with pytest.raises(FileNotFoundError, match=r"must have a layer\.json or a tileset.json"):
        serve.FolderStore(tmp_path / name)


# --- pages, and running it ------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["", "viewer.html", "cesium.html"])
def test_pages_may_load_from_the_server_only(port, path):
    status, headers, body = ask(port, path)
    assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert headers["content-security-policy"].startswith("default-src 'none'")
    assert b"//" not in body.replace(b"<!doctype", b"")


def test_cesium_is_served_from_where_npm_puts_it(store, tmp_path):
    build = tmp_path / "node_modules/cesium/Build/Cesium"
    build.mkdir(parents=True)
    (build / "Cesium.js").write_text("cesium")
    for folder in (tmp_path, tmp_path / "node_modules/cesium", build):
        with serving(store, cesium=folder) as port:
            assert ask(port, "cesium/Cesium.js")[2] == b"cesium"
            assert ask(port, "cesium/..%2f..%2fpackage.json")[0] == 404
    with pytest.raises(FileNotFoundError, match="npm install --prefix"):
        serve.application(store, cesium=tmp_path / "elsewhere")


@pytest.mark.parametrize("name", ["workers", "pending", "cache_bytes", "max_age"])
def test_options_out_of_range_are_refused(store, name):
    with pytest.raises(ValueError, match=f"{name} must be .* or more, got -1"):
        serve.application(store, **{name: -1})


def test_a_taken_port_is_told_with_what_to_do(store):
    with serving(store) as port, pytest.raises(OSError, match=f"port {port} .* another program"):
        serve.run(store, port=port)


def test_an_address_that_cannot_be_is_told(store):
    for host in ("no.such.host.invalid", "192.0.2.1"):
        with pytest.raises(OSError, match=rf"port 0 of {host}: this machine has no such address;"):
            serve.run(store, host, 0)
    with pytest.raises(ValueError, match="port must be 0 to 65535, got 70000"):
        serve.run(store, port=70000)


RUN = "import sys; from rtin import serve; serve.run(serve.FolderStore(sys.argv[1]), port=0)"


@contextmanager
def started(*arguments):
    """Yield a server's process and its port."""
    process = subprocess.Popen(
        [sys.executable, "-u", "-W", "error", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        line = next(line for line in process.stdout if "127.0.0.1:" in line)
        yield process, int(line.split("127.0.0.1:")[1].split("/")[0])
    finally:
        process.kill()
        process.wait()


def interrupted(process):
    """Return the status and the complaints of a process after Ctrl-C."""
    process.send_signal(signal.SIGINT)
    _, complaints = process.communicate(timeout=60)
    return process.returncode, complaints


@pytest.mark.parametrize("busy", [False, True])
def test_ctrl_c_ends_it_quietly(folder_of_tiles, busy):
    with started("-c", RUN, folder_of_tiles) as (process, port):
        assert ask(port, TILE)[0] == 200
        clients = [socket.create_connection(("127.0.0.1", port)) for _ in range(3 * busy)]
        for client in clients:
            client.sendall(b"GET / HT")
        assert interrupted(process) == (0, "")
        for client in clients:
            client.close()


def test_the_command_serves_a_folder_until_ctrl_c(folder_of_tiles):
    with started("-m", "rtin", "serve", folder_of_tiles, "--port", 0) as (process, port):
        assert ask(port, TILE, accept_encoding="gzip")[2] == (folder_of_tiles / TILE).read_bytes()
        assert interrupted(process)[0] == 0


def test_the_command_serves_a_raster_until_ctrl_c(tmp_path):
    raster = write_island(tmp_path / "island.tif", shape=(40, 50))
    options = ("--port", 0, "--max-error", 8, "--workers", 1)
    with started("-m", "rtin", "serve", raster, *options) as (process, port):
        layer = json.loads(ask(port, "layer.json")[2])
        last = layer["available"][-1][0]
        tile = f"{layer['maxzoom']}/{last['startX']}/{last['startY']}.terrain"
        assert ask(port, tile)[0] == 200
        status, complaints = interrupted(process)
        assert status == 0
        assert "Traceback" not in complaints


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [(["missing"], "missing"), (["empty"], "layer.json"), (["empty", "--port", "70000"], "port")],
)
def test_the_command_tells_in_a_line_what_it_cannot_serve(tmp_path, arguments, reason):
    (tmp_path / "empty").mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "rtin", "serve", *arguments],
        cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
