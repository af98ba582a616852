"""What notebooks and scripts show of terrain."""

import base64
import html
import io
import os
import re
import subprocess
import sys
import warnings
import webbrowser
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import numpy as np
import pytest
from PIL import Image

import rtin
from chromium import CHROMIUM, FLAGS, seen, terrain_share
from hand_meshes import bumpy, in_degrees, touching_at_a_point, with_hole
from rtin import samples
from rtin.viewer import notebook


def picture_in(text):
    """The picture beside a cell, shape (rows, cols, 4)."""
    (data,) = re.findall(r'src="data:image/webp;base64,([^"]+)"', text)
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        return np.asarray(image.convert("RGBA"), dtype=int)


def words_in(text):
    return html.unescape(" ".join(re.sub("<[^>]*>", " ", text).split()))


# --- beside a cell --------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [100.1, 1.0, 0.0])
def test_flat_terrain_has_one_colour(height):
    image = picture_in(rtin.Grid(np.full((300, 300), height))._repr_html_())[5:-5, 5:-5]
    assert np.ptp(image, axis=(0, 1)).max() < 8  # WebP loses some


@pytest.mark.parametrize("shape", [bumpy, in_degrees, with_hole, touching_at_a_point])
def test_a_mesh_is_shown_with_its_counts(shape):
    mesh = shape()
    text = mesh._repr_html_()
    said = words_in(text)
    assert f"triangles {mesh.n_triangles:,} vertices {mesh.n_vertices:,}" in said
    assert f"z {mesh.bounds[0, 2]:.8g} to {mesh.bounds[1, 2]:.8g}" in said
    image = picture_in(text)
    assert len(np.unique(image[image[..., 3] == 255], axis=0)) > 50


def test_a_grid_is_shown_with_its_samples_and_voids():
    heights = np.add.outer(np.arange(30.0), np.arange(50.0))
    heights[5:10, 20:30] = np.nan
    text = rtin.Grid(heights, crs="EPSG:32616")._repr_html_()
    said = words_in(text)
    assert "samples 30 × 50, float32 voids 50" in said
    assert "WGS 84 / UTM zone 16N" in said
    image = picture_in(text)
    rows, cols = image.shape[:2]
    transparent = image[..., 3] == 0
    assert transparent[round(7 / 29 * rows), round(25 / 49 * cols)]
    assert 50 / 1500 < transparent.mean() < 130 / 1500


def test_what_a_mesh_does_not_cover_is_transparent():
    image = picture_in(with_hole()._repr_html_())
    rows, cols = image.shape[:2]
    assert image[rows // 2, cols // 2, 3] == 0
    assert image[rows // 6, cols // 2, 3] == 255


def test_the_picture_is_as_wide_as_the_land():
    """At a latitude of 60 a degree of longitude is half as long as one of latitude."""
    heights = np.add.outer(np.arange(41.0), np.arange(41.0))
    grid = rtin.Grid(heights, (0.01, 0.0, 10.0, 0.0, -0.01, 60.2), "EPSG:4326")
    for surface in (grid, rtin.coarsen(grid, max_error=0.5)):
        rows, cols = picture_in(surface._repr_html_()).shape[:2]
        assert cols / rows == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    "transform", [(30.0, 0, 0, 0, -30.0, 0), (30.0, 0, 0, 0, 30.0, 0), (-30.0, 0, 0, 0, -30.0, 0)]
)
def test_north_is_up_and_light_comes_from_the_north_west(transform):
    row, col = np.indices((60, 60))
    a, _, _, _, e, _ = transform
    x, y = a * (col - 30), e * (row - 30)
    grid = rtin.Grid(-np.hypot(x, y), transform)
    for surface in (grid, rtin.coarsen(grid, max_error=1.0)):
        image = picture_in(surface._repr_html_())[..., :3].sum(axis=2)
        quarter = image.shape[0] // 4
        north_west = image[quarter : quarter + 40, quarter : quarter + 40].mean()
        south_east = image[-quarter - 40 : -quarter, -quarter - 40 : -quarter].mean()
        assert north_west > south_east + 50


def test_edges_are_drawn_where_they_can_be_told_apart():
    grid = rtin.Grid(np.zeros((9, 9)))
    few = picture_in(rtin.TriangleMesh(*two_triangles())._repr_html_())
    assert len(np.unique(few[..., :3] // 16, axis=0)) > 1
    dark = few[..., :3].sum(axis=2) < few[..., :3].sum(axis=2).max() - 60
    diagonal = [dark[i, i] for i in range(50, 400)]
    assert np.mean(diagonal) > 0.9 or np.mean(np.fliplr(dark).diagonal()[50:400]) > 0.9
    plain = picture_in(grid._repr_html_())
    assert np.ptp(plain[..., :3].sum(axis=2)) < 30


def two_triangles():
    corners = np.array([[0.0, 0.0, 5.0], [100.0, 0.0, 5.0], [100.0, 100.0, 5.0], [0.0, 100.0, 5.0]])
    return corners, np.array([[0, 2, 3], [2, 0, 1]])


def broken_meshes():
    corners, triangles = two_triangles()
    nothing = np.empty((0, 3))
    nowhere = corners.copy()
    nowhere[1] = np.nan
    huge = corners * 1e200
    return {
        "nothing": rtin.TriangleMesh(nothing, nothing.astype(int)),
        "no triangle": rtin.TriangleMesh(corners, nothing.astype(int)),
        "NaN": rtin.TriangleMesh(nowhere, triangles),
        "infinite": rtin.TriangleMesh(np.where(np.isnan(nowhere), np.inf, nowhere), triangles),
        "huge": rtin.TriangleMesh(huge, triangles),
        "a point": rtin.TriangleMesh(corners * 0.0, triangles),
        "edge-on": rtin.TriangleMesh(corners * [0.0, 1.0, 1.0], triangles),
        "beyond the poles": rtin.TriangleMesh(corners * [1, 10, 1], triangles, "EPSG:4326"),
    }


@pytest.mark.parametrize("name", broken_meshes())
def test_a_mesh_that_cannot_be_drawn_is_told_of(name, capfd):
    mesh = broken_meshes()[name]
    assert f"triangles {mesh.n_triangles}" in words_in(mesh._repr_html_())
    assert capfd.readouterr() == ("", "")


def test_a_name_with_markup_is_no_markup(monkeypatch):
    grid = rtin.Grid(np.eye(5), crs='LOCAL_CS["<script>alert(1)</script>"]')
    assert "<script>" not in grid._repr_html_()
    assert "<script>" in words_in(grid._repr_html_().replace("</table>", ""))


def test_nothing_is_drawn_before_somebody_asks():
    code = "import sys, rtin; rtin.Grid([[0, 1], [2, 3]]); print('rtin.viewer' in sys.modules)"
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert said.stdout.strip() == "False"


# --- pages ----------------------------------------------------------------------------------------


@pytest.fixture
def opened(monkeypatch, tmp_path):
    """The files that a browser is asked to open."""
    files = []

    def open_(url):
        files.append(Path(url2pathname(urlparse(url).path)))
        return True

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(webbrowser, "open", open_)
    return files


def title_of(path):
    return re.search("<title>(.*?)</title>", path.read_text("utf-8")).group(1)


def test_a_script_opens_a_page_of_the_mesh_as_it_is(opened):
    mesh = bumpy()
    assert mesh.show() is None
    assert rtin.show(mesh) is None
    assert len(set(opened)) == 2
    for path in opened:
        assert title_of(path) == f"rtin: {mesh.n_triangles} triangles, {mesh.n_vertices} vertices"
    assert opened[0].read_bytes() == opened[1].read_bytes()


def test_a_page_is_that_of_write_mesh(opened, tmp_path):
    mesh = bumpy()
    mesh.show(exaggeration=3.0)
    rtin.write_mesh(mesh, tmp_path / "mesh.html", z_scale=3.0)
    assert opened[0].read_bytes() == (tmp_path / "mesh.html").read_bytes()


@pytest.mark.parametrize("kind", ["grid", "mesh"])
def test_what_is_too_large_is_shown_simpler_and_says_so(opened, kind, monkeypatch):
    pages = []
    monkeypatch.setattr(notebook, "page_of", lambda mesh, **_: pages.append(mesh) or b"")
    grid = samples.jacksboro_fault()
    surface = grid if kind == "grid" else rtin.coarsen(grid, max_error=2.0)
    surface.show(max_triangles=20_000)
    (mesh,) = pages
    assert 19_000 < mesh.n_triangles <= 20_000
    best = rtin.vertical_error(rtin.coarsen(grid, max_triangles=20_000), grid).max
    assert rtin.vertical_error(mesh, grid).max < 4.0 * best
    assert np.allclose(
        mesh.bounds[:, :2], surface.bounds[:, :2] if kind == "mesh" else mesh.bounds[:, :2]
    )
    monkeypatch.undo()


def test_the_page_tells_of_how_many_triangles_it_shows_the_best(opened):
    mesh = rtin.coarsen(samples.jacksboro_fault(), max_error=20.0)
    mesh.show(max_triangles=5000)
    page = opened[0].read_text("utf-8")
    shown = int(re.search(r"rtin: ([\d,]+) triangles", page).group(1).replace(",", ""))
    assert shown <= 5000
    assert f"vertices, of {mesh.n_triangles:,} triangles ·" in page


def test_a_grid_full_of_voids_is_shown_with_fewer_of_its_samples(opened):
    heights = np.random.default_rng(0).normal(size=(129, 129))
    heights[np.random.default_rng(1).random(heights.shape) < 0.05] = np.nan
    rtin.Grid(heights).show(max_triangles=600)
    shown = int(re.search(r"rtin: ([\d,]+) triangles", opened[0].read_text("utf-8")).group(1))
    assert 0 < shown <= 600


def test_a_raster_is_thinned_before_it_is_simplified(monkeypatch, opened):
    seen = []

    def remember(grid, **options):
        seen.append(grid)
        return bumpy()

    monkeypatch.setattr(notebook, "coarsen", remember)
    grid = rtin.Grid(np.add.outer(np.arange(900.0), np.arange(700.0)), (2.0, 0, 5.0, 0, -2.0, 7.0))
    grid.show(max_triangles=5000)
    (thin,) = seen
    assert thin.n_samples <= 8 * 5000
    assert (thin.heights == grid.heights[::4, ::4]).all()
    assert tuple(thin.transform)[:6] == (8.0, 0.0, 5.0, 0.0, -8.0, 7.0)


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"exaggeration": 0.0}, ValueError, "exaggeration must be"),
        ({"exaggeration": "much"}, TypeError, "exaggeration must be"),
        ({"max_triangles": 1}, ValueError, "max_triangles must be 2 or more"),
        ({"max_triangles": 2.5}, TypeError, "max_triangles must be a whole number"),
    ],
)
def test_bad_options_are_refused(opened, options, error, match):
    with pytest.raises(error, match=match):
        bumpy().show(**options)
    assert opened == []


@pytest.mark.parametrize("name", ["nothing", "no triangle", "NaN", "infinite"])
def test_a_mesh_without_a_surface_is_not_shown(opened, name):
    with pytest.raises(ValueError, match=r"a mesh with triangles|vertices must be finite"):
        broken_meshes()[name].show()


def test_nothing_but_terrain_is_shown(opened):
    with pytest.raises(TypeError, match="a Grid or a TriangleMesh is wanted, got list"):
        rtin.show([1, 2, 3])


def test_without_a_browser_the_error_says_where_the_page_is(opened, monkeypatch):
    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    with pytest.raises(OSError, match="there is no browser") as caught:
        bumpy().show()
    path = Path(str(caught.value).split("the page is ")[1])
    assert title_of(path).startswith("rtin: ")


@pytest.mark.skipif(os.name != "posix", reason="a browser that is a shell script")
def test_a_script_ends_while_its_page_is_open(tmp_path):
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" >> "{tmp_path}/opened"\n')
    browser.chmod(0o755)
    code = "import rtin; rtin.Grid([[0, 1, 2], [2, 3, 5], [1, 1, 9]]).show()"
    given = {"BROWSER": str(browser), "TMPDIR": str(tmp_path), "HOME": os.environ["HOME"]}
    subprocess.run([sys.executable, "-c", code], env=os.environ | given, check=True, timeout=120)
    (url,) = (tmp_path / "opened").read_text().split()
    assert title_of(Path(url2pathname(urlparse(url).path))).startswith("rtin: 7 triangles")


# --- in a real notebook ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def outputs():
    """What the cells of a notebook have below them, run by a Jupyter kernel."""
    pytest.importorskip("ipykernel")
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    cells = [
        "import numpy as np, rtin\n"
        "row, col = np.indices((40, 60))\n"
        "grid = rtin.Grid(100.0 * np.sin(row / 7) * np.cos(col / 9), (9, 0, 0, 0, -9, 0))\n"
        "mesh = rtin.coarsen(grid, max_error=1.0)",
        "grid",
        "mesh",
        "mesh.show(exaggeration=2.0)\n'the last expression'",
        "grid.show(max_triangles=300)",
        "rtin.TriangleMesh([[0, 0, 0]], np.empty((0, 3), int))",
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Jupyter's own
        book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
        nbclient.NotebookClient(book, timeout=240, kernel_name="python3").execute()
    return [cell.outputs for cell in book.cells]


def test_a_cell_that_ends_with_terrain_shows_it(outputs):
    for (output,), word in zip(outputs[1:3], ("samples 40 × 60", "triangles"), strict=True):
        assert output.output_type == "execute_result"
        assert output.data["text/plain"].startswith("<")
        assert word in words_in(output.data["text/html"])
        image = picture_in(output.data["text/html"])
        assert len(np.unique(image.reshape(-1, 4), axis=0)) > 100


def test_a_mesh_without_a_picture_is_shown_in_words(outputs):
    (output,) = outputs[5]
    assert "triangles 0 vertices 1" in words_in(output.data["text/html"])


def test_show_puts_the_page_below_the_cell_wherever_it_is_called(outputs):
    page, last = outputs[3]
    assert page.output_type == "display_data"
    assert page.data["text/plain"].startswith("<TriangleMesh ")
    assert last.data["text/plain"] == "'the last expression'"
    (other,) = outputs[4]
    for output in (page, other):
        document = html.unescape(
            re.search('srcdoc="(.*?)"', output.data["text/html"], re.S).group(1)
        )
        assert document.startswith("<!DOCTYPE html>")
        assert "<title>rtin: " in document
    assert ", of 2,400 samples" in document


@pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")
def test_the_page_below_a_cell_shows_terrain(outputs, tmp_path):
    from playwright.sync_api import sync_playwright

    path = tmp_path / "cell.html"
    path.write_text(f"<!DOCTYPE html><body>{outputs[3][0].data['text/html']}</body>", "utf-8")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 500, "height": 500})
        complaints = []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(path.as_uri())
        page.frame_locator("iframe").locator("canvas").wait_for()
        shown = seen(page, lambda picture: terrain_share(picture) > 0.15)
        browser.close()
    assert complaints == []
    assert terrain_share(shown) > 0.15
