"""Pictures and films of terrain, drawn without a screen."""

import importlib.util
import os
import re
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import rtin
from hand_meshes import bumpy, in_degrees
from rtin.cli import app
from rtin.viewer import _offscreen, cameras, pictures
from rtin.viewer.scene import SIDE, Settings, Terrain, View

SMALL = (160, 90)


def can_draw():
    try:
        _offscreen.require_renderer()
    except OSError:
        return False
    return importlib.util.find_spec("pyvista") is not None


needs_renderer = pytest.mark.skipif(not can_draw(), reason="needs pyvista, and EGL or a screen")


def hills(shape=(65, 97), step=30.0):
    row, col = np.indices(shape)
    heights = 300.0 + 250.0 * np.sin(row / 9) * np.cos(col / 11)
    return rtin.Grid(heights, (step, 0.0, 4e5, 0.0, -step, 5e6))


@pytest.fixture(scope="module")
def terrain():
    return pictures.as_terrain(hills())


def sky(size=SMALL):
    """The picture of a view that turns its back on the terrain."""
    away = View((0.0, -300.0, 50.0), (0.0, -600.0, 50.0))
    return pictures.picture(bumpy(), away, size=size)


def shows_terrain(image):
    """Which pixels are not as without any terrain."""
    difference = image.astype(int) - sky((image.shape[1], image.shape[0]))
    return np.abs(difference).max(axis=2) > 12


# --- what is drawn --------------------------------------------------------------------------------


@needs_renderer
@pytest.mark.parametrize("source", [hills, bumpy, in_degrees], ids=["grid", "mesh", "degrees"])
def test_a_picture_shows_terrain_in_the_middle_and_sky_above(source):
    image = pictures.picture(source(), size=SMALL)
    assert image.shape == (90, 160, 3)
    assert image.dtype == np.uint8
    seen = shows_terrain(image)
    assert seen[35:55, 60:100].mean() > 0.95
    assert not seen[:3].any()
    assert len(np.unique(image[seen], axis=0)) > 100


@needs_renderer
def test_terrain_is_where_its_corners_are_seen(terrain):
    view = View((20.0, -90.0, 60.0), (0.0, 0.0, 0.0))
    seen = shows_terrain(pictures.picture(terrain, view, size=SMALL))
    rows, cols = np.nonzero(seen)
    corners = np.array(np.meshgrid(*terrain.bounds.T)).reshape(3, -1).T
    forward = np.subtract(view.target, view.eye) / np.linalg.norm(
        np.subtract(view.target, view.eye)
    )
    right = np.cross(forward, view.up)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, forward), forward])
    x, y, depth = axes @ (terrain.place.into_scene(corners) - np.array(view.eye)).T
    pixels = 45.0 / np.tan(np.radians(30.0)) / depth
    left, end = 80.0 + (x * pixels).min(), 80.0 + (x * pixels).max()
    top, bottom = 45.0 - (y * pixels).max(), 45.0 - (y * pixels).min()
    # Bounds are those of a box; in its upper and lower corners there is no terrain.
    assert left - 1 <= cols.min() <= left + 6
    assert end - 6 <= cols.max() <= end + 1
    assert top - 1 <= rows.min() <= top + 12
    assert bottom - 12 <= rows.max() <= bottom + 1


@needs_renderer
def test_north_west_slopes_are_lighter_than_south_east_ones():
    row, col = np.indices((65, 65))
    ridge = rtin.Grid(-np.abs(row + col - 64.0) * 10.0, (30.0, 0.0, 0.0, 0.0, -30.0, 0.0))
    above = View((0.0, -1.0, 140.0), (0.0, 0.0, 0.0))
    for source in (ridge, rtin.coarsen(ridge, max_error=0.0)):
        image = pictures.picture(source, above, size=(120, 120)).astype(int).sum(axis=2)
        assert image[40:50, 40:50].mean() > image[70:80, 70:80].mean() + 50


@needs_renderer
def test_heights_are_exaggerated(terrain):
    low = View((0.0, -120.0, 0.0), (0.0, 0.0, 0.0))
    tall = [
        shows_terrain(pictures.picture(terrain, low, settings=settings, size=SMALL)).sum()
        for settings in (Settings(), Settings(exaggeration=3.0))
    ]
    assert tall[1] > 1.8 * tall[0]


@needs_renderer
def test_the_wireframe_draws_dark_edges(terrain):
    coarse = Settings("tolerance", max_error=50.0)
    plain = pictures.picture(terrain, settings=coarse, size=(640, 360)).astype(int)
    edged = pictures.picture(
        terrain, settings=replace(coarse, wireframe=True), size=(640, 360)
    ).astype(int)
    changed = np.abs(plain - edged).max(axis=2) > 20
    assert 0.02 < changed.mean() < 0.6
    assert (edged[changed].sum(axis=1) < plain[changed].sum(axis=1)).mean() > 0.99


@needs_renderer
def test_colours_may_be_chosen(terrain):
    images = [
        pictures.picture(terrain, settings=Settings(colours=name, pixel_error=8.0), size=SMALL)
        for name in terrain.painters
    ]
    assert len(images) == 3
    for number, image in enumerate(images):
        assert all((image != other).mean() > 0.1 for other in images[:number])


@needs_renderer
def test_vertices_may_have_colours_of_ones_own():
    mesh = bumpy()
    red = Terrain(
        mesh, painters={"red": lambda mesh: np.tile([1.0, 0.0, 0.0], (mesh.n_vertices, 1))}
    )
    image = pictures.picture(red, settings=Settings(colours="red"), size=SMALL)
    assert (image[35:55, 60:100] == [255, 0, 0]).all()
    blended = shows_terrain(image) & (image != [255, 0, 0]).any(axis=2)
    assert blended.sum() > 30  # along the border, which is smoothed


@needs_renderer
def test_the_level_of_detail_is_that_of_the_camera(terrain, monkeypatch):
    counts, original = [], Terrain.shown

    def counted(self, view, settings):
        shown = original(self, view, settings)
        counts.append((view.height, shown.mesh.n_triangles))
        return shown

    monkeypatch.setattr(Terrain, "shown", counted)
    near = View((0.0, -60.0, 20.0), (0.0, -20.0, 0.0))
    far = View((0.0, -2000.0, 900.0), (0.0, 0.0, 0.0))
    for view, size in ((near, SMALL), (far, SMALL), (near, (480, 270))):
        pictures.picture(terrain, view, size=size)
    (_, close), (_, distant), (height, large) = counts
    assert height == 270
    assert large > close > 2 * distant


@needs_renderer
def test_the_same_picture_is_drawn_again(terrain):
    images = [pictures.picture(terrain, size=SMALL) for _ in range(2)]
    assert (images[0] == images[1]).all()


# --- pictures in files ----------------------------------------------------------------------------


def frames(path, size=SMALL):
    """The pictures of a film, as ffmpeg reads them."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", path]
    raw = subprocess.run(
        [*command, "-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True, check=True,
    ).stdout  # fmt: skip
    return list(np.frombuffer(raw, np.uint8).reshape(-1, size[1], size[0], 3).astype(int))


@needs_renderer
@pytest.mark.parametrize(("name", "most"), [("a.png", 0), ("a.jpg", 60), ("A.JPEG", 60)])
def test_a_snapshot_is_the_picture(terrain, tmp_path, name, most):
    path = tmp_path / name
    pictures.snapshot(terrain, path, size=SMALL)
    with Image.open(path) as file:
        read = np.asarray(file.convert("RGB"), dtype=int)
    assert np.abs(read - pictures.picture(terrain, size=SMALL)).max() <= most
    assert list(tmp_path.iterdir()) == [path]


@needs_renderer
@pytest.mark.parametrize("name", ["film.gif", "film.mp4"])
def test_the_pictures_of_a_film_are_those_of_its_views(terrain, tmp_path, name):
    path, done = tmp_path / name, []
    views = cameras.orbit(4, terrain)
    pictures.record(terrain, path, views, size=(160, 90), tell=done.append)
    shown = frames(path)
    assert len(shown) == len(views)
    assert done == [0.25, 0.5, 0.75, 1.0]
    wanted = [pictures.picture(terrain, view, size=SMALL).astype(int) for view in views]
    for number, frame in enumerate(shown):
        off = [np.abs(frame - image).mean() for image in wanted]
        assert np.argmin(off) == number
        assert min(off) < 12
    assert list(tmp_path.iterdir()) == [path]


@needs_renderer
def test_an_extension_in_capitals_is_the_same_film(terrain, tmp_path):
    """The pace and the endless repetition too, not only the format."""
    for name in ("small.gif", "CAPITALS.GIF"):
        pictures.record(terrain, tmp_path / name, cameras.orbit(3), size=(40, 30))
    small, capitals = (tmp_path / name for name in ("small.gif", "CAPITALS.GIF"))
    assert small.read_bytes() == capitals.read_bytes()


@needs_renderer
def test_a_film_may_show_another_terrain_in_each_view(tmp_path):
    path = tmp_path / "rising.gif"
    terrains = (bumpy(heights=np.zeros((7, 9)) + np.arange(9) * tall) for tall in (0.0, 20.0, 60.0))
    view = View((0.0, -120.0, 10.0), (0.0, 0.0, 0.0))
    pictures.record(terrains, path, [view] * 3, size=SMALL)
    assert all(np.abs(a - b).max() > 40 for a, b in pairwise(frames(path)))


@needs_renderer
def test_nothing_of_a_picture_is_left_in_the_next_one():
    """Neither terrain nor drape nor how far the camera sees."""
    row, col = np.indices((33, 33))
    place = (30.0, 0.0, 0.0, 0.0, -30.0, 0.0)
    heights = (300.0 * np.sin(row / 5.0), 10.0 * np.sin(col / 3.0), np.zeros((33, 33)))
    sources = [pictures.as_terrain(rtin.Grid(height, place)) for height in heights]
    views = View((0.0, -900.0, 600.0), (0.0, 0.0, 0.0)), View((0.0, -20.0, 30.0), (0.0, 0.0, 0.0))
    scenes = [(source, view) for source in sources for view in views]
    with pictures._Stage(SMALL) as stage:
        drawn = [stage.draw(*scene, Settings()) for scene in scenes]
    for image, scene in zip(drawn, scenes, strict=True):
        assert (image == pictures.picture(*scene, size=SMALL)).mean() > 0.999


@needs_renderer
@pytest.mark.parametrize("rate", [10.0, 25.0])
def test_a_film_is_as_fast_as_it_was_asked_for_and_a_gif_never_ends(terrain, tmp_path, rate):
    import imageio_ffmpeg

    for name in ("a.gif", "a.mp4"):
        views = cameras.orbit(3, terrain)
        pictures.record(terrain, tmp_path / name, views, size=SMALL, frames_per_second=rate)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.info["duration"] == pytest.approx(1000.0 / rate)
        assert film.info["loop"] == 0
    reader = imageio_ffmpeg.read_frames(tmp_path / "a.mp4")
    assert next(reader)["fps"] == pytest.approx(rate)
    reader.close()


@needs_renderer
def test_a_film_of_odd_size_is_cut_to_what_players_show(terrain, tmp_path):
    path = tmp_path / "odd.mp4"
    pictures.record(terrain, path, cameras.orbit(2), size=(163, 91))
    assert [frame.shape for frame in frames(path, (162, 90))] == [(90, 162, 3)] * 2


@needs_renderer
@pytest.mark.parametrize("name", ["film.gif", "film.mp4"])
@pytest.mark.parametrize("failure", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_film_leaves_the_old_one(terrain, tmp_path, name, failure):
    path = tmp_path / name
    path.write_bytes(b"old")

    def stop(share):
        if share > 0.5:
            raise failure

    with pytest.raises(failure):
        pictures.record(terrain, path, cameras.orbit(4), size=SMALL, tell=stop)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@needs_renderer
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_leaves_nothing_of_a_film(tmp_path):
    np.save(tmp_path / "dem.npy", hills().heights)
    command = [sys.executable, "-m", "rtin", "view", "dem.npy", "--record", "film.mp4",
               "--size", "320x180", "--frames", "5000"]  # fmt: skip
    with subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        while not list(tmp_path.glob(".film*")) and process.poll() is None:
            pass
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        _, said = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["dem.npy"]


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.tif", "a", "a.mp4", ".png"])
def test_a_picture_of_another_kind_is_refused_before_anything_is_drawn(tmp_path, name):
    with pytest.raises(ValueError, match=r"a picture must end in one of \.png"):
        pictures.snapshot("no terrain", tmp_path / name)


@pytest.mark.parametrize("name", ["a.png", "a.avi", "film"])
def test_a_film_of_another_kind_is_refused_before_anything_is_drawn(tmp_path, name):
    with pytest.raises(ValueError, match=r"a film must end in one of \.mp4"):
        pictures.record("no terrain", tmp_path / name, cameras.orbit(2))


def test_a_missing_folder_is_told_before_anything_is_drawn(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        pictures.snapshot("no terrain", tmp_path / "no" / "a.png")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        pictures.record("no terrain", tmp_path / "no" / "a.gif", cameras.orbit(2))


@needs_renderer
def test_a_film_without_views_is_refused(terrain, tmp_path):
    with pytest.raises(ValueError, match="at least one view"):
        pictures.record(terrain, tmp_path / "a.gif", [])
    assert list(tmp_path.iterdir()) == []


@needs_renderer
def test_a_film_has_a_terrain_for_each_view(terrain, tmp_path):
    with pytest.raises(ValueError, match="terrain for each of the 3 views, got 2"):
        pictures.record(iter([terrain] * 2), tmp_path / "a.gif", cameras.orbit(3), size=SMALL)
    assert list(tmp_path.iterdir()) == []
    pictures.record([terrain] * 5, tmp_path / "a.gif", cameras.orbit(3), size=SMALL)
    assert len(frames(tmp_path / "a.gif")) == 3


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, 50.1])
def test_a_film_has_pictures_in_a_second_and_not_too_many(tmp_path, rate):
    with pytest.raises(ValueError, match=r"frames_per_second must be .* at most 50 for"):
        pictures.record(bumpy(), tmp_path / "a.gif", cameras.orbit(2), frames_per_second=rate)


@pytest.mark.parametrize(
    "size", [(0, 90), (160, -1), (160.0, 90), (160,), 160, (20_000, 90), "big"]
)
def test_a_size_is_two_whole_numbers_that_fit(size):
    with pytest.raises(ValueError, match="size must be"):
        pictures.picture(bumpy(), size=size)


@pytest.mark.parametrize("size", [(1, 90), (0, 90), (160,), 160, "big"])
def test_a_wrong_size_of_a_film_is_told_as_it_was_given(tmp_path, size):
    with pytest.raises(ValueError, match=re.escape(f"got {size!r}")):
        pictures.record(bumpy(), tmp_path / "a.mp4", cameras.orbit(2), size=size)


@needs_renderer
def test_nothing_but_terrain_is_drawn():
    with pytest.raises(TypeError, match="is wanted, got list"):
        pictures.picture([1, 2, 3])


def test_pyvista_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setattr(pictures, "require_renderer", lambda: None)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r"pictures need pyvista .*rtin\[view\]"):
        pictures.picture(bumpy())


@needs_renderer
@pytest.mark.parametrize(
    ("missing", "name"), [("imageio", "a.gif"), ("imageio", "a.mp4"), ("imageio_ffmpeg", "a.mp4")]
)
def test_imageio_and_its_ffmpeg_are_named_where_they_are_missing(
    terrain, tmp_path, monkeypatch, missing, name
):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ImportError, match=rf"films need imageio .*{missing}.*rtin\[view\]"):
        pictures.record(terrain, tmp_path / name, cameras.orbit(2), size=SMALL)
    assert list(tmp_path.iterdir()) == []


# --- with nothing to draw with --------------------------------------------------------------------


@pytest.fixture
def bare(monkeypatch):
    """A machine on which neither X nor EGL nor OSMesa is found."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    monkeypatch.setenv("DISPLAY", ":987")
    monkeypatch.setattr(_offscreen, "_loaded", lambda name: None)
    monkeypatch.setattr(_offscreen, "find_library", lambda name: None)


def test_a_machine_that_cannot_draw_is_told_what_to_install(bare):
    with pytest.raises(OSError, match=r"apt-get install libegl1 libgl1-mesa-dri"):
        pictures.picture(bumpy())


def test_the_program_says_so_in_one_line(bare, tmp_path):
    np.save(tmp_path / "dem.npy", hills().heights)
    out = tmp_path / "a.png"
    result = CliRunner().invoke(app, ["view", str(tmp_path / "dem.npy"), "--snapshot", str(out)])
    assert result.exit_code == 1
    assert "apt-get install" in result.output.replace("\n", " ")
    assert "Traceback" not in result.output
    assert not out.exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="how Linux finds EGL")
@pytest.mark.parametrize("display", ["", ":987"])
def test_what_can_draw_is_found_without_a_screen(display):
    """In a process of its own, whose DISPLAY nobody answers."""
    if not can_draw():
        pytest.skip("needs EGL")
    code = """
        import os
        from rtin.viewer._offscreen import require_renderer
        require_renderer()
        print(os.environ["VTK_DEFAULT_OPENGL_WINDOW"])
    """
    given = {key: value for key, value in os.environ.items() if not key.startswith("VTK_")}
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env=given | {"DISPLAY": display}, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert result.stdout.strip() == "vtkEGLRenderWindow"
    assert result.stderr == ""


@needs_renderer
@pytest.mark.parametrize(
    ("settings", "wanted"),
    [(Settings("tolerence"), "mode must be .*'tolerance', got 'tolerence'"),
     (Settings(colours="pink"), "colours must be .*'height'.*, got 'pink'"),
     (Settings(pixel_error=0.0), "pixel_error must be more than zero, got 0.0"),
     (Settings(exaggeration=-1.0), "exaggeration must be from .*, got -1"),
     (Settings(max_triangles=0), "max_triangles must be more than zero, got 0")],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(terrain, settings, wanted):
    with pytest.raises(ValueError, match=wanted):
        pictures.picture(terrain, settings=settings, size=SMALL)


@needs_renderer
@pytest.mark.parametrize(
    ("options", "wanted"),
    [({"settings": {}}, "settings must be a Settings, got dict"),
     ({"view": (0.0, 0.0, 1.0)}, "view must be a View, got tuple")],
)  # fmt: skip
def test_what_is_no_view_and_no_settings_is_refused(terrain, options, wanted):
    with pytest.raises(TypeError, match=wanted):
        pictures.picture(terrain, **options)


def test_what_is_no_film_is_refused(terrain, tmp_path):
    view = cameras.overlook(terrain)
    for views, options, wanted in (
        ([view, 1], {}, "a view must be a View, got int"),
        (iter([view]), {"settings": 2}, "settings must be a Settings, got int"),
        ([view], {"frames_per_second": "a"}, "frames_per_second must be a number, got 'a'"),
    ):
        with pytest.raises(TypeError, match=wanted):
            pictures.record(terrain, tmp_path / "a.gif", views, **options)
    assert list(tmp_path.iterdir()) == []


@needs_renderer
def test_a_mesh_has_no_error_to_be_coloured_by():
    mesh = rtin.coarsen(hills(), max_error=1.0)
    with pytest.raises(ValueError, match="colours must be 'hillshade' or 'height', got 'error'"):
        pictures.picture(mesh, settings=Settings(colours="error"), size=SMALL)


# --- from the command line ------------------------------------------------------------------------


@needs_renderer
def test_the_program_writes_a_picture_and_a_film(tmp_path):
    np.save(tmp_path / "dem.npy", hills().heights)
    still, film = tmp_path / "a.png", tmp_path / "a.gif"
    command = ["view", str(tmp_path / "dem.npy"), "--snapshot", str(still), "--record", str(film)]
    more = ["--size", "160x90", "--frames", "3", "--path", "flight", "--exaggeration", "0.02"]
    result = CliRunner().invoke(app, [*command, *more])
    assert result.exit_code == 0, result.output
    with Image.open(still) as file:
        assert file.size == SMALL
        assert shows_terrain(np.asarray(file.convert("RGB"))).mean() > 0.2
    assert len(frames(film)) == 3


@pytest.mark.parametrize(
    ("flag", "name", "size"), [("--snapshot", "a.png", "0x90"), ("--record", "a.mp4", "1x90")]
)
def test_the_program_tells_a_wrong_size_before_it_opens_anything(tmp_path, flag, name, size):
    path = str(tmp_path / name)
    result = CliRunner().invoke(app, ["view", "missing.npy", flag, path, "--size", size])
    assert result.exit_code == 2
    assert f"got ({size.replace('x', ', ')})" in result.output


@pytest.mark.parametrize(("flag", "name"), [("--snapshot", "a.bmp"), ("--record", "a.avi")])
def test_an_extension_that_cannot_be_is_bad_usage(tmp_path, flag, name):
    result = CliRunner().invoke(app, ["view", "missing.npy", flag, str(tmp_path / name)])
    assert result.exit_code == 2
    assert "must end in one of" in result.output


def test_a_film_is_refused_a_fixed_eye(tmp_path):
    points = ["--eye", "0,0,9", "--target", "0,0,0"]
    film = ["--record", str(tmp_path / "a.gif")]
    result = CliRunner().invoke(app, ["view", "missing.npy", *film, *points])
    assert result.exit_code == 2
    assert "--eye is for --snapshot" in result.output


@pytest.mark.parametrize(
    ("options", "told"),
    [("--target 1,2,3", "--target is for --snapshot"),
     ("--snapshot a.png --path flight", "--path is for --record"),
     ("--snapshot a.png --frames 9", "--frames is for --record"),
     ("--size 9x9", "--size is for --snapshot and --record"),
     ("--record a.gif --port 0", "--port is for the page"),
     ("--record a.gif --host ::1", "--host is for the page"),
     ("--snapshot a.png --no-browser", "--no-browser is for the page"),
     ("--snapshot a.png --eye nan,1,2 --target 0,0,0", "--eye must be three numbers"),
     ("--snapshot a.png --eye 1,2 --target 0,0,0", "--eye must be three numbers"),
     ("--snapshot a.png --eye 1,2,3 --target 0,inf,0", "--target must be three numbers"),
     ("--snapshot a.png --eye 1,2,3 --target 1,2,3.0", "must be two points"),
     ("--max-triangles 1", "--max-triangles must be at least 2, got 1"),
     ("--exaggeration 1e300", "exaggeration must be from 1e-06 to 1e+06"),
     ("--exaggeration 0", "exaggeration must be from")],
)  # fmt: skip
def test_what_cannot_be_meant_is_bad_usage(options, told):
    result = CliRunner().invoke(app, ["view", "missing.npy", *options.split()])
    assert result.exit_code == 2
    assert told in " ".join(result.output.replace("│", " ").split())


@pytest.mark.parametrize(
    "option",
    ["--pixel-error 2", "--max-triangles 9", "--max-error 1", "--colours error", "--band 2",
     "--encoding terrarium"],
)  # fmt: skip
def test_a_mesh_is_refused_what_is_for_rasters(option):
    result = CliRunner().invoke(app, ["view", "missing.ply", *option.split()])
    assert result.exit_code == 2
    flag = option if "colours" in option else option.split()[0]
    assert f"{flag} is for rasters" in result.output


@needs_renderer
@pytest.mark.parametrize(("flatter", "told"), [("1", True), ("9", True), ("0.1", False)])
def test_heights_that_make_a_needle_are_pointed_out(tmp_path, flatter, told):
    np.save(tmp_path / "dem.npy", np.pad([[100.0]], 8))
    command = ["view", str(tmp_path / "dem.npy"), "--snapshot", str(tmp_path / "a.png")]
    more = ["--size", "160x90", "--exaggeration", flatter]
    result = CliRunner().invoke(app, [*command, *more])
    assert result.exit_code == 0, result.output
    assert ("range over 100, x and y over 16 " in result.output) == told
    assert ("--exaggeration 0.03 flattens" in result.output) == told


@needs_renderer
def test_a_needle_that_was_asked_for_is_not_pointed_out(tmp_path):
    np.save(tmp_path / "dem.npy", np.pad([[10.0]], 8))
    command = ["view", str(tmp_path / "dem.npy"), "--snapshot", str(tmp_path / "a.png")]
    result = CliRunner().invoke(app, [*command, "--size", "160x90", "--exaggeration", "20"])
    assert result.exit_code == 0, result.output
    assert "units" not in result.output


@needs_renderer
@pytest.mark.parametrize(("target", "told"), [("8,-8,0", False), ("-8,8,0", True)])
def test_an_eye_that_sees_nothing_is_told_where_the_terrain_is(tmp_path, target, told):
    np.save(tmp_path / "dem.npy", np.pad([[10.0]], 8))
    command = ["view", str(tmp_path / "dem.npy"), "--snapshot", str(tmp_path / "a.png")]
    more = ["--size", "160x90", "--eye=-5,5,3", f"--target={target}"]
    result = CliRunner().invoke(app, [*command, *more])
    assert result.exit_code == 0, result.output
    assert ("nothing of dem.npy is in" in result.output) == told
    assert ("it lies within 0,-16,0 to 16,0,10" in result.output) == told


@needs_renderer
def test_samples_without_a_triangle_are_told_instead_of_drawn(tmp_path):
    np.save(tmp_path / "dem.npy", np.pad([[10.0]], 4, constant_values=np.nan))
    out = tmp_path / "a.png"
    command = ["view", str(tmp_path / "dem.npy"), "--snapshot", str(out)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 1
    assert "the grid has no triangle to keep" in result.output
    assert not out.exists()


@pytest.mark.parametrize("flag", [("--snapshot", "a.png"), ("--record", "a.gif")])
def test_the_program_names_pyvista_before_it_opens_anything(flag, monkeypatch):
    monkeypatch.setattr(pictures, "require_renderer", lambda: None)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    result = CliRunner().invoke(app, ["view", "missing.npy", *flag])
    assert result.exit_code == 1
    assert "pictures need pyvista" in result.output
    assert result.output.count("\n") == 1


@needs_renderer
def test_the_program_tells_the_size_that_a_film_has(tmp_path):
    np.save(tmp_path / "dem.npy", hills().heights)
    command = ["view", str(tmp_path / "dem.npy"), "--record", str(tmp_path / "a.mp4")]
    result = CliRunner().invoke(app, [*command, "--size", "41x31", "--frames", "2"])
    assert "2 pictures of 40 × 30 pixels" in result.output


@needs_renderer
def test_the_program_looks_from_where_it_is_told(tmp_path):
    grid = hills()
    mesh = rtin.coarsen(grid, max_error=1.0)
    rtin.write_mesh(mesh, tmp_path / "mesh.ply")
    eye, target = mesh.bounds[1] + [500.0, 500.0, 900.0], mesh.bounds.mean(axis=0)
    points = [",".join(map(repr, point.tolist())) for point in (eye, target)]
    out = tmp_path / "a.png"
    result = CliRunner().invoke(
        app,
        ["view", str(tmp_path / "mesh.ply"), "--snapshot", str(out), "--size", "160x90",
         "--eye", points[0], "--target", points[1]],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    terrain = pictures.as_terrain(mesh)
    view = cameras.seen_from(terrain.place, eye, target)
    with Image.open(out) as file:
        assert (np.asarray(file) == pictures.picture(terrain, view, size=SMALL)).mean() > 0.99


def test_the_scene_is_of_the_size_that_cameras_take_it_for():
    assert pictures.as_terrain(bumpy()).place.into_scene(bumpy().bounds)[1, 0] == SIDE / 2.0
