"""Colours of meshes, and pictures laid over terrain: in the right place, and what they show."""

import io

import numpy as np
import pyproj
import pytest
import rasterio
import trimesh
from affine import Affine
from PIL import Image
from rasterio.enums import ColorInterp, Resampling

import rtin
from film import as_shown
from hand_meshes import bumpy
from rtin import _tint
from rtin.grid import Grid
from rtin.io import _gltf
from rtin.viewer import _photos, colours
from rtin.viewer.cameras import overlook
from rtin.viewer.colours import Drape, by_error, by_height, hillshade, orthophoto
from rtin.viewer.opening import Opening
from rtin.viewer.scene import Settings, Terrain
from test_opening import PLACE, TURNED, places, terrain, with_overviews
from test_read_grid import one_line, write_raster


def opened(tmp_path, place=PLACE, crs="EPSG:32628", name="dem.tif", heights=None):
    heights = terrain() if heights is None else heights
    path = write_raster(tmp_path / name, heights, transform=place, crs=crs)
    with Opening(path) as opens:
        return opens.first()


def centres(drape):
    """x and y of the centres of pixels, shape (rows, cols, 2)."""
    return places(Grid(np.zeros(drape.image.shape[:2]), drape.transform))


# Drapes


def test_a_drape_has_its_own_colours_at_the_centres_of_pixels():
    image = np.random.default_rng(1).integers(0, 256, (5, 8, 3)).astype(np.uint8)
    drape = Drape(image, TURNED)
    found = drape.at(centres(drape).reshape(-1, 2))
    np.testing.assert_allclose(255 * found, image.reshape(-1, 3), atol=1e-4)


def test_a_drape_is_bilinear_between_and_goes_on_beyond():
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 1], image[1, 1] = 100, 200
    drape = Drape(image, Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0))
    red = 255 * drape.at([[0.5, 0.0], [0.25, -0.5], [7.0, 9.0], [-3.0, -0.5]])[:, 0]
    np.testing.assert_allclose(red, [50.0, 0.25 * 150.0, 100.0, 0.0])


@pytest.mark.parametrize("place", [PLACE, TURNED], ids=["north up", "turned"])
def test_texture_coordinates_go_from_edge_to_edge_of_the_picture(place):
    drape = Drape(np.zeros((4, 10, 3), np.uint8), place)
    uv = drape.texture_coordinates(centres(drape).reshape(-1, 2))
    row, col = np.indices((4, 10)).reshape(2, -1)
    np.testing.assert_allclose(uv, np.column_stack([(col + 0.5) / 10, (row + 0.5) / 4]), atol=1e-6)
    assert uv.dtype == np.float32


def test_a_jpeg_holds_the_picture():
    row, col = np.indices((40, 60))
    image = np.stack([4 * col, 6 * row, 0 * row + 90], axis=-1).astype(np.uint8)
    decoded = np.asarray(Image.open(io.BytesIO(Drape(image, PLACE).jpeg)))
    assert np.abs(as_shown(decoded) - image).mean() < 4


def test_a_glb_with_a_picture_shows_it_where_the_vertices_are():
    mesh = bumpy()
    (west, south, _), (east, north, _) = mesh.bounds
    image = np.zeros((20, 30, 3), np.uint8)
    image[:10, :15], image[10:, 15:] = (200, 50, 50), (50, 50, 200)
    step_x, step_y = (east - west) / 30, (south - north) / 20
    place = Affine(step_x, 0.0, west + step_x / 2, 0.0, step_y, north + step_y / 2)
    drape = Drape(image, place)
    jpeg = drape.jpeg
    attributes = {
        "POSITION": _gltf.y_up(mesh.vertices).astype("<f4"),
        "TEXCOORD_0": drape.texture_coordinates(mesh.vertices).astype("<f4"),
        "JPEG": np.frombuffer(jpeg + bytes(-len(jpeg) % 4), "u1"),
    }
    glb = _gltf.packed(
        mesh.triangles.astype("<u4"), attributes, lambda t: _gltf.lay_over(t, "JPEG", len(jpeg))
    )
    (read,) = trimesh.load(io.BytesIO(glb), file_type="glb", process=False).geometry.values()
    seen = read.visual.to_color().vertex_colors[:, :3].astype(int)
    np.testing.assert_allclose(read.vertices, _gltf.y_up(mesh.vertices), atol=1e-3)
    x, y, _ = mesh.vertices.T
    away = (np.abs(x - (west + east) / 2) > 20) & (np.abs(y - (south + north) / 2) > 20)
    away &= (x > west) & (x < east) & (y > south) & (y < north)  # where trimesh begins again
    expected = np.rint(255 * drape(mesh))
    assert away.sum() >= 20
    assert np.abs(as_shown(seen) - expected)[away].max() < 40


# Painters


def test_heights_are_tinted_from_the_lowest_to_the_highest():
    mesh = bumpy()
    np.testing.assert_array_equal(
        by_height(0.0, 500.0)(mesh), _tint.tint(mesh.vertices[:, 2], 0.0, 500.0)
    )


@pytest.mark.parametrize(
    ("heights", "n_blue"),
    [([-20, 0, 1, 400], 2), ([0, 1, 400], 1), ([5, 9], 0), ([-9, -5, 0], 0), ([0, 0], 0)],
)
def test_zero_and_below_are_sea_where_there_is_land(heights, n_blue):
    red, _, blue = _tint.tint(np.array(heights, float), heights[0], heights[-1]).T
    np.testing.assert_array_equal(blue > red, np.arange(len(heights)) < n_blue)


def naive_differences(mesh, grid):
    """What ``by_error`` looks at, a sample at a time."""
    at = {tuple(np.round(xy, 6)): h for xy, h in zip(
        places(grid).reshape(-1, 2), grid.heights.ravel(), strict=True)}  # fmt: skip
    largest = np.zeros(mesh.n_vertices)
    for triangle in mesh.triangles:
        a, b, apex = mesh.vertices[triangle]
        middle = (a + b) / 2
        for point in (middle, (middle + apex) / 2):
            height = at.get(tuple(np.round(point[:2], 6)), np.nan)
            if not np.isnan(height):
                difference = abs(point[2] - height)
                largest[triangle] = np.maximum(largest[triangle], difference)
    return largest


@pytest.mark.parametrize("place", [PLACE, TURNED], ids=["north up", "turned"])
@pytest.mark.parametrize("shape", [(33, 33), (20, 47)])
def test_errors_are_the_largest_differences_at_two_samples_of_a_triangle(place, shape):
    heights = terrain(*shape).astype(np.float64)
    heights[4:9, 12:15] = np.nan
    grid = Grid(heights, place)
    mesh = rtin.coarsen(grid, max_error=20.0)
    found = colours.vertex_differences(mesh, grid)
    np.testing.assert_allclose(found, naive_differences(mesh, grid), atol=1e-6)
    assert 1.0 < found.max() <= rtin.vertical_error(mesh, grid).max + 1e-9


def test_an_exact_mesh_is_pale_and_a_bad_one_dark():
    grid = Grid(terrain(65, 65))
    paint = by_error(grid)
    pale, dark = (paint(rtin.coarsen(grid, max_error=error)).mean(axis=1) for error in (0.0, 300.0))
    np.testing.assert_allclose(pale, _tint.heat(np.zeros(1)).mean())
    assert dark.min() < 0.3


def test_the_error_shown_darkest_can_be_chosen():
    grid = Grid(terrain(65, 65))
    mesh = rtin.coarsen(grid, max_error=50.0)
    error = colours.vertex_differences(mesh, grid)
    paint = by_error(grid, 100.0)
    np.testing.assert_allclose(paint(mesh), _tint.heat(error / 100.0), atol=1e-9)
    np.testing.assert_array_equal(paint.within(7.0)(mesh), paint(mesh))


def test_the_largest_error_is_darkest_unless_there_is_a_tolerance():
    grid = Grid(terrain(65, 65))
    mesh = rtin.coarsen(grid, max_error=50.0)
    error = colours.vertex_differences(mesh, grid)
    paint = by_error(grid)
    np.testing.assert_allclose(paint(mesh), _tint.heat(error / error.max()), atol=1e-9)
    for allowed in (50.0, np.linspace(0.0, 90.0, mesh.n_vertices)[::-1]):
        with np.errstate(divide="ignore"):
            expected = _tint.heat(error / allowed)
        np.testing.assert_allclose(paint.within(allowed)(mesh), expected, atol=1e-9)


@pytest.mark.parametrize(
    "chosen",
    [Settings(pixel_error=4.0, exaggeration=3.0), Settings("triangle budget", max_triangles=300),
     Settings("tolerance", max_error=30.0)],
    ids=lambda chosen: chosen.mode,
)  # fmt: skip
def test_in_a_picture_what_is_allowed_is_darkest(chosen):
    grid = Grid(terrain(65, 65), PLACE)
    shows = Terrain(grid, painters={"error": by_error(grid)})
    view = overlook(shows, chosen.exaggeration)
    shown = shows.shown(view, chosen)
    errors = colours.vertex_differences(shown.mesh, grid)
    shares = errors / shown.painter.allowed
    assert 0.5 < shares.max() <= 1.02  # a vertex is a little nearer or further than its samples
    np.testing.assert_allclose(shown.painter(shown.mesh), _tint.heat(shares), atol=1e-9)
    if chosen.mode != "tolerance":
        depth = np.linalg.norm(shown.vertices - view.eye, axis=1)
        drawn = shown.painter.allowed * shows.place.scale * chosen.exaggeration
        pixels = 1080 / 2 / np.tan(np.radians(30.0)) * drawn / depth
        np.testing.assert_allclose(pixels, pixels[0])
        assert chosen.mode == "triangle budget" or pixels[0] == pytest.approx(4.0)


@pytest.mark.parametrize("most", [0.0, -1.0, np.inf, np.nan])
def test_an_impossible_largest_error_is_refused(most):
    with pytest.raises(ValueError, match="most must be more than zero") as error:
        by_error(Grid(terrain(9, 9)), most)
    assert one_line(error)


def test_what_is_no_grid_is_refused():
    for paint in (by_error, hillshade):
        with pytest.raises(TypeError, match="a Grid is wanted"):
            paint(terrain(9, 9))


# Relief


def test_a_hillshade_is_that_of_plots(tmp_path):
    grid = Grid(terrain(), TURNED)
    drape = hillshade(grid)
    slopes = (slope.ravel() for slope in _tint.slopes(grid.heights.astype(float), TURNED))
    expected = _tint.relief(grid.heights.ravel().astype(float), *slopes)[:, :3]
    np.testing.assert_allclose(drape.image.reshape(-1, 3), 255 * expected, atol=0.51)
    assert drape.transform == TURNED


@pytest.mark.parametrize("place", [PLACE, TURNED], ids=["north up", "turned"])
def test_slopes_are_those_of_a_plane(place):
    xy = places(Grid(terrain(), place))
    slope_x, slope_y = _tint.slopes(0.25 * xy[:, :, 0] - 2.0 * xy[:, :, 1], place)
    np.testing.assert_allclose(slope_x, 0.25, atol=1e-6)
    np.testing.assert_allclose(slope_y, -2.0, atol=1e-6)


def test_what_faces_north_west_is_bright():
    bump = np.zeros((31, 31))
    bump[10:21, 10:21] = 30.0
    image = hillshade(Grid(bump, PLACE)).image.astype(int).sum(axis=-1)
    assert image[10, 10] > image[3, 3] > image[20, 20]


@pytest.mark.parametrize("shape", [(150, 210), (149, 208), (2, 300)])
@pytest.mark.parametrize("longest", [70, 50, 7])
def test_a_large_relief_is_averaged_in_its_place(shape, longest):
    heights = terrain(*shape).astype(np.float64)
    heights[40:43, 50:100] = np.nan
    grid = Grid(heights, TURNED)
    drape = hillshade(grid, longest=longest)
    step = -(-max(shape) // longest)
    assert max(drape.image.shape[:2]) <= longest
    means = colours._means(grid.heights, step)
    first = heights[:step, :step]
    assert means[0, 0] == pytest.approx(first.mean())
    assert np.nanmean(heights[-(shape[0] % step or step) :, :step]) == pytest.approx(
        means[-1, 0]
    ) or (shape[0] < 2 * step)
    row, col = grid.places(centres(drape)[0, 0][np.newaxis])[0]
    assert (row, col) == pytest.approx(((step - 1) / 2, (step - 1) / 2), abs=1e-5)


def test_voids_of_a_relief_are_grey():
    heights = terrain(40, 50).astype(np.float64)
    heights[10:20, 10:20] = np.nan
    assert (hillshade(Grid(heights)).image[12:18, 12:18] == colours._GREY).all()


# Photographs


def gradient(shape):
    """Red is the column, green the row, in steps of 2."""
    row, col = np.indices(shape)
    return np.stack([2 * col, 2 * row, np.full(shape, 40)]).astype(np.uint8)


def photo_of(path, xy_to_colour, place, shape, crs, **more):
    """A photograph whose colours are a function of where its pixels' centres are in its CRS."""
    row, col = np.indices(shape)
    a, b, x, d, e, y = tuple(place)[:6]
    col, row = col + 0.5, row + 0.5
    bands = xy_to_colour(a * col + b * row + x, d * col + e * row + y)
    return write_raster(path, np.stack(bands).astype(np.uint8), transform=place, crs=crs, **more)


def test_a_photograph_of_the_same_pixels_comes_as_it_is(tmp_path):
    terrain_opened = opened(tmp_path)
    cells = Affine(10.0, 0.0, 5005.0, 0.0, -10.0, 8995.0)  # from the first to the last sample
    image = gradient((149, 209))[:, :, :209]
    path = write_raster(tmp_path / "photo.tif", image, transform=cells)
    drape = orthophoto(path, terrain_opened)
    np.testing.assert_array_equal(drape.image, np.moveaxis(image, 0, -1))
    assert drape.transform.almost_equals(Affine(10.0, 0.0, 5010.0, 0.0, -10.0, 8990.0))


@pytest.mark.parametrize("overviews", [[], [2, 4]], ids=["plain", "overviews"])
@pytest.mark.parametrize("longest", [2048, 60])
@pytest.mark.parametrize("dem", ["north up", "turned", "degrees"])
def test_a_photograph_in_another_crs_lies_right_to_half_a_pixel(tmp_path, dem, longest, overviews):
    """Red grows by 1 in each pixel to the east, green to the north."""
    place, crs = {
        "north up": (Affine(10.0, 0.0, 500_000.0, 0.0, -10.0, 5_000_000.0), "EPSG:32632"),
        "turned": (
            Affine.translation(5e5, 5e6) @ Affine.rotation(33) @ Affine.scale(9.0, -9.0),
            "EPSG:32632",
        ),
        "degrees": (Affine(1e-4, 0.0, 9.0, 0.0, -1e-4, 45.15), "EPSG:4326"),
    }[dem]
    terrain_opened = opened(tmp_path, place, crs)
    a, _, c, _, e, f = tuple(terrain_opened.to_crs)[:6]
    (west, south), (east, north) = terrain_opened.bounds * [a, e] + [c, f]
    to_photo = pyproj.Transformer.from_crs(crs, "EPSG:3857", always_xy=True)
    left, bottom, right, top = to_photo.transform_bounds(west, south, east, north)
    side = max(right - left, top - bottom) / 230
    corner = Affine(side, 0.0, left - 10 * side, 0.0, -side, top + 10 * side)
    path = photo_of(
        tmp_path / "photo.tif",
        lambda x, y: ((x - left) / side + 10, (top - y) / side + 10, 0 * x),
        corner,
        (250, 250),
        "EPSG:3857",
    )
    with_overviews(path, overviews)
    drape = orthophoto(path, terrain_opened, longest=longest)
    xy = centres(drape).reshape(-1, 2) * [a, e] + [c, f]
    x, y = to_photo.transform(*xy.T)
    wanted = np.column_stack([(x - left) / side + 10, (top - y) / side + 10])
    found = drape.image.reshape(-1, 3)[:, :2]
    pixel = max(1.0, 230 / longest)
    assert max(drape.image.shape) <= longest
    assert np.abs(found - wanted).max() <= 0.5 * pixel + 1.0  # the bytes are cut off: 1
    assert np.abs((found - wanted).mean(axis=0) + 0.5).max() <= 0.25 * pixel


def test_a_picture_without_a_place_lies_over_the_whole_extent(tmp_path):
    terrain_opened = opened(tmp_path)
    image = gradient((50, 70))
    Image.fromarray(np.moveaxis(image, 0, -1)).save(tmp_path / "picture.png")
    drape = orthophoto(tmp_path / "picture.png", terrain_opened)
    np.testing.assert_array_equal(drape.image, np.moveaxis(image, 0, -1))
    (west, south), (east, north) = terrain_opened.bounds
    uv = drape.texture_coordinates([[west, north], [east, south], [west, south]])
    np.testing.assert_allclose(uv, [[0, 0], [1, 1], [0, 1]], atol=1e-6)


def test_a_large_picture_is_reduced(tmp_path):
    Image.new("RGB", (400, 90), (10, 200, 30)).save(tmp_path / "picture.png")
    drape = orthophoto(tmp_path / "picture.png", opened(tmp_path), longest=100)
    assert drape.image.shape == (72, 100, 3)
    assert (drape.image == (10, 200, 30)).all()


def test_a_palette_shows_its_colours(tmp_path):
    numbers = np.zeros((149, 209), np.uint8)
    numbers[:, 100:] = 7
    colormap = {0: (255, 0, 0, 255), 7: (0, 0, 255, 255)}
    path = write_raster(
        tmp_path / "photo.tif", numbers, colormap=colormap,
        transform=Affine(10.0, 0.0, 5005.0, 0.0, -10.0, 8995.0),
    )  # fmt: skip
    drape = orthophoto(path, opened(tmp_path), longest=50)
    assert set(map(tuple, drape.image.reshape(-1, 3).tolist())) == {(255, 0, 0), (0, 0, 255)}


def test_one_band_is_grey_and_wide_numbers_are_stretched(tmp_path):
    col = np.indices((150, 210))[1]
    path = write_raster(tmp_path / "photo.tif", (300 + 40 * col).astype(np.uint16), transform=PLACE)
    image = orthophoto(path, opened(tmp_path)).image
    assert (image[:, :, :1] == image).all()
    assert image[0, 2, 0] == 0
    assert image[0, 104, 0] == pytest.approx(128, abs=2)
    assert image[0, -2, 0] == 255


@pytest.mark.parametrize("hidden_by", ["alpha", "nodata", "mask", "extent"])
def test_where_a_photograph_has_nothing_the_drape_below_is_seen(tmp_path, hidden_by):
    terrain_opened = opened(tmp_path)
    bands = np.full((3, 150, 210), 90, np.uint8)
    options, place = {}, PLACE
    half = np.arange(210) < 105
    if hidden_by == "alpha":
        bands = np.concatenate([bands, np.broadcast_to(255 * ~half, (1, 150, 210))])
        meanings = ("red", "green", "blue", "alpha")
        options["colorinterp"] = [ColorInterp[name] for name in meanings]
    elif hidden_by == "nodata":
        bands[:, :, half] = 3
        options["nodata"] = 3
    elif hidden_by == "mask":
        options["mask"] = np.broadcast_to(~half, (150, 210))
    else:
        bands, place = bands[:, :, ~half], Affine(10.0, 0.0, 6050.0, 0.0, -10.0, 9000.0)
    path = write_raster(tmp_path / "photo.tif", bands.astype(np.uint8), transform=place, **options)
    below = Drape(
        np.full((2, 2, 3), 210, np.uint8), Affine(2000.0, 0.0, 5000.0, 0.0, -1400.0, 9000.0)
    )
    image = orthophoto(path, terrain_opened, under=below).image
    plain = orthophoto(path, terrain_opened).image
    assert (image[:, 110:] == 90).all()
    assert (image[:, :100] == 210).all()
    assert (plain[:, :100] == colours._GREY).all()


def test_a_photograph_without_a_crs_is_in_the_terrains(tmp_path):
    photo = write_raster(tmp_path / "photo.tif", gradient((150, 125)), transform=PLACE, crs=None)
    drape = orthophoto(photo, opened(tmp_path))
    assert (drape.image[5:-5, 5:100, 0] > 0).all()


def test_terrain_and_photograph_may_both_have_no_crs(tmp_path):
    terrain_opened = opened(tmp_path, crs=None)
    photo = write_raster(tmp_path / "photo.tif", gradient((125, 125)), transform=PLACE, crs=None)
    drape = orthophoto(photo, terrain_opened)
    assert drape.image[0, 50, 0] == pytest.approx(101, abs=1)


def test_a_photograph_is_read_from_the_overview_that_is_fine_enough(tmp_path, monkeypatch):
    path = write_raster(tmp_path / "photo.tif", gradient((125, 125)), transform=PLACE)
    with_overviews(path, [2, 4, 8], Resampling.nearest)
    asked = []
    open_raster = _photos.open_raster
    monkeypatch.setattr(
        _photos,
        "open_raster",
        lambda name, **options: (
            asked.append(options.get("overview")) or open_raster(name, **options)
        ),
    )
    orthophoto(path, opened(tmp_path), longest=42)  # 5 pixels in one
    orthophoto(path, opened(tmp_path), longest=2048)
    assert asked == [None, 1, None, None]


@pytest.mark.parametrize(
    ("terrain_crs", "place", "photo_crs", "said"),
    [
        ("EPSG:32628", Affine(10.0, 0.0, 95000.0, 0.0, -10.0, 9000.0), "EPSG:32628", "elsewhere"),
        (None, PLACE, "EPSG:32628", "has a CRS and the terrain has none"),
    ],
)
def test_a_photograph_that_can_not_be_placed_is_refused(
    tmp_path, terrain_crs, place, photo_crs, said
):
    photo = write_raster(tmp_path / "a.tif", gradient((90, 90)), transform=place, crs=photo_crs)
    with pytest.raises(ValueError, match=rf"a\.tif.*{said}") as error:
        orthophoto(photo, opened(tmp_path, crs=terrain_crs))
    assert one_line(error)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "float32", "float64"])
def test_wide_numbers_have_an_edge_too(tmp_path, dtype):
    """GDAL's own mask knows the alpha of bytes only."""
    grey = (7 + np.indices((150, 105))[1]).astype(dtype)
    path = write_raster(
        tmp_path / "a.tif", grey, transform=Affine(10.0, 0.0, 6050.0, 0.0, -10.0, 9000.0)
    )
    below = Drape(np.full((150, 210, 3), (9, 99, 199), np.uint8), PLACE)
    image = orthophoto(path, opened(tmp_path), under=below).image
    assert (image[2:-2, 2:100] == (9, 99, 199)).all()
    assert (image[2:-2, 110:, :1] == image[2:-2, 110:]).all()
    away = Affine(10.0, 0.0, 96050.0, 0.0, -10.0, 9000.0)
    far = write_raster(tmp_path / "far.tif", grey, transform=away)
    with pytest.raises(ValueError, match="elsewhere"):
        orthophoto(far, opened(tmp_path))


def test_a_photograph_with_control_points_only_is_refused(tmp_path):
    points = [
        rasterio.control.GroundControlPoint(row, col, 9.0 + col / 100, 45.0 - row / 100)
        for row in (0, 90)
        for col in (0, 90)
    ]
    path = write_raster(
        tmp_path / "a.tif", gradient((90, 90)), transform=None, gcps=points, crs="EPSG:4326"
    )
    with pytest.raises(ValueError, match="ground control points only") as error:
        orthophoto(path, opened(tmp_path))
    assert one_line(error)


def test_a_bad_file_is_refused_in_one_line(tmp_path):
    terrain_opened = opened(tmp_path)
    (tmp_path / "a.jpg").write_bytes(b"no picture at all")
    for name in ("a.jpg", "missing.jpg"):
        with pytest.raises(OSError, match=name) as error:
            orthophoto(tmp_path / name, terrain_opened)
        assert one_line(error)


def test_a_photograph_that_is_cut_off_is_refused(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (3, 150, 210)).astype(np.uint8)
    path = write_raster(tmp_path / "a.tif", noise, transform=PLACE, compress="deflate")
    path.write_bytes(path.read_bytes()[:60_000])
    with pytest.raises(OSError, match=r"a\.tif") as error:
        orthophoto(path, opened(tmp_path))
    assert one_line(error)
