"""Rasters and meshes opened to be looked at: what comes first, what follows, and when it ends."""

import threading
import warnings

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.enums import Resampling
from rasterio.errors import NotGeoreferencedWarning

import rtin
from hand_meshes import bumpy, in_degrees
from rtin.grid import Grid
from rtin.io import _thinning
from rtin.viewer import opening
from rtin.viewer.opening import Opening
from test_read_grid import LAYOUTS, encode, one_line, write_raster

PLACE = Affine(10.0, 0.0, 5000.0, 0.0, -10.0, 9000.0)
TURNED = Affine.translation(4e5, 5e6) @ Affine.rotation(33) @ Affine.scale(2.0, -3.0)


def terrain(rows=150, cols=210):
    row, col = np.mgrid[:rows, :cols]
    return np.round(500 + 300 * np.sin(row / 17) * np.cos(col / 23) + row).astype(np.float32)


@pytest.fixture
def coarse(monkeypatch):
    """Open small rasters as if they were large ones: stages of 100, 1600, … samples."""
    monkeypatch.setattr(opening, "_FIRST_SAMPLES", 100)


def stages(path, **options):
    """All that an opening gives, first to last."""
    found, done = [], threading.Event()

    def take(opened):
        found.append(opened)
        if opened.is_final:
            done.set()

    def fail(error):
        found.append(error)
        done.set()

    with Opening(path, **options) as opens:
        found.append(opens.first())
        opens.go_on(take, fail)
        assert found[0].is_final or done.wait(60)
    failures = [item for item in found if isinstance(item, Exception)]
    if failures:
        raise failures[0]
    return found


def places(grid):
    """x and y of all samples, shape (rows, cols, 2)."""
    row, col = np.indices(grid.shape)
    a, b, x, d, e, y = tuple(grid.transform)[:6]
    return np.stack([a * col + b * row + x, d * col + e * row + y], axis=-1)


def spacing(grid):
    a, b, _, d, e, _ = tuple(grid.transform)[:6]
    return max(np.hypot(a, d), np.hypot(b, e))


@pytest.mark.parametrize("place", [PLACE, TURNED], ids=["north up", "turned"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_stage_has_samples_of_the_raster_at_their_places(tmp_path, coarse, place, layout):
    heights = terrain()
    heights[40:70, 90:130] = np.nan
    path = write_raster(tmp_path / "a.tif", heights, transform=place, **LAYOUTS[layout])
    whole = rtin.read_grid(path)
    found = stages(path)
    assert [stage.is_final for stage in found] == [False, False, True]
    for stage in found:
        xy = places(stage.surface).reshape(-1, 2)
        row, col = np.rint(whole.places(xy)).astype(int).T
        np.testing.assert_allclose(places(whole)[row, col], xy, atol=1e-6)
        np.testing.assert_array_equal(whole.heights[row, col], stage.surface.heights.ravel())
    np.testing.assert_array_equal(found[-1].surface.heights, heights)
    assert found[-1].surface.transform == whole.transform
    assert found[-1].surface.crs == whole.crs == found[0].crs


@pytest.mark.parametrize("shape", [(150, 210), (151, 208), (40, 700)])
@pytest.mark.parametrize("factors", [[], [2], [2, 4, 8, 16]], ids=str)
def test_all_stages_span_the_same_ground(tmp_path, coarse, shape, factors):
    path = write_raster(tmp_path / "a.tif", terrain(*shape), transform=PLACE)
    with_overviews(path, factors)
    whole = places(rtin.read_grid(path)).reshape(-1, 2)
    for stage in stages(path):
        corners = places(stage.surface).reshape(-1, 2)
        np.testing.assert_allclose(stage.bounds, [whole.min(axis=0), whole.max(axis=0)])
        missing = np.abs(stage.bounds - [corners.min(axis=0), corners.max(axis=0)])
        assert missing.max() <= 0.75 * spacing(stage.surface) + 1e-6
        assert spacing(stage.surface) == pytest.approx(10.0 * stage.step)


def with_overviews(path, factors, resampling=Resampling.average):
    if not factors:
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as file:
            file.build_overviews(factors, resampling)


@pytest.mark.parametrize("place", [PLACE, TURNED, None], ids=["north up", "turned", "nowhere"])
@pytest.mark.parametrize("shape", [(160, 224), (147, 209)])
def test_an_overview_lies_in_the_middle_of_the_samples_it_stands_for(
    tmp_path, monkeypatch, place, shape
):
    """Means over a plane lie on the plane, if they are where they are said to be."""
    monkeypatch.setattr(opening, "_FIRST_SAMPLES", 600)
    row, col = np.indices(shape)
    plane = (3.0 * row + 2.0 * col).astype(np.float64)
    path = write_raster(tmp_path / "a.tif", plane, transform=place)
    with_overviews(path, [2, 4, 8])
    first = stages(path)[0]
    assert 7.7 < first.step < 8.1
    whole = rtin.read_grid(path)
    row, col = whole.places(places(first.surface).reshape(-1, 2)).T
    inner = (slice(None, -1), slice(None, -1))  # the last are of fewer samples
    expected = (3.0 * row + 2.0 * col).reshape(first.surface.shape)
    # Where the shape is no multiple of 8, GDAL takes whole samples only.
    atol = 1e-6 if shape == (160, 224) else 5.0
    np.testing.assert_allclose(first.surface.heights[inner], expected[inner], atol=atol)


def test_overviews_are_read_before_the_samples(tmp_path, coarse):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    with_overviews(path, [2, 4, 8, 16])
    with rasterio.open(path, overview_level=3) as file:
        coarsest = file.read(1)
    first = stages(path)[0]
    assert coarsest.shape == (10, 14)
    np.testing.assert_array_equal(first.surface.heights, coarsest[::2, ::2])


def test_voids_of_an_overview_stay_voids(tmp_path, coarse):
    heights = terrain()
    heights[30:90, 60:160] = -9999.0
    path = write_raster(tmp_path / "a.tif", heights, transform=PLACE, nodata=-9999.0)
    with_overviews(path, [8])
    first = stages(path)[0].surface
    assert np.nanmin(first.heights) > 0.0
    assert np.isnan(first.heights_at([[5000 + 1100, 9000 - 600]])).all()


def test_overviews_of_coded_heights_are_left_alone(tmp_path, coarse):
    """The mean of two colours is no height between theirs."""
    heights = terrain()
    path = write_raster(tmp_path / "a.tif", encode(heights, 0.1, -10000.0), transform=PLACE)
    with_overviews(path, [2, 4, 8])
    first = stages(path)[0].surface
    whole = rtin.read_grid(path)
    row, col = np.rint(whole.places(places(first).reshape(-1, 2))).astype(int).T
    np.testing.assert_array_equal(first.heights.ravel(), whole.heights[row, col])


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:4979"])
def test_degrees_become_metres_round_the_middle_of_the_whole(tmp_path, coarse, crs):
    place = Affine(0.001, 0.0, 8.0, 0.0, -0.001, 47.0)
    path = write_raster(tmp_path / "a.tif", terrain(), transform=place, crs=crs)
    found = stages(path)
    whole = rtin.read_grid(path)
    metric = whole.in_metres()
    assert found[-1].surface.transform == metric.transform
    for stage in found:
        assert stage.surface.crs is None
        assert stage.crs == whole.crs
        xy = places(stage.surface).reshape(-1, 2)
        row, col = metric.places(xy).T
        nearest = np.rint(row).astype(int), np.rint(col).astype(int)
        np.testing.assert_allclose(nearest, (row, col), atol=1e-6)
        np.testing.assert_array_equal(stage.surface.heights.ravel(), whole.heights[nearest])
        a, _, c, _, e, f = tuple(stage.to_crs)[:6]
        in_degrees = np.column_stack([a * xy[:, 0] + c, e * xy[:, 1] + f])
        np.testing.assert_allclose(whole.places(in_degrees), np.column_stack([row, col]), atol=1e-6)


def test_an_array_is_opened_coarse_first(tmp_path, coarse):
    heights = terrain()
    np.save(tmp_path / "a.npy", heights)
    found = stages(tmp_path / "a.npy")
    assert len(found) == 3
    assert found[0].surface.heights.size <= 100
    np.testing.assert_array_equal(found[-1].surface.heights, heights)


def test_a_small_raster_is_whole_at_once(tmp_path):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    (only,) = stages(path)
    assert only.is_final
    assert only.step == 1.0
    assert only.note == "all 150 × 210 samples"


def test_where_many_blocks_would_be_decoded_few_samples_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(opening, "_FIRST_SAMPLES", 1000)
    monkeypatch.setattr(opening, "_MOST_DECODED", 10_000)
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE, **LAYOUTS["tiles"])
    decoded = []
    read = _thinning.Thinned.read

    def counted(self, indexes, **options):
        dataset = self._dataset

        class Counting:
            def __getattr__(self, name):
                return getattr(dataset, name)

            def read(self, indexes, *, window, **more):
                decoded.append(window)
                return dataset.read(indexes, window=window, **more)

        self._dataset = Counting()
        return read(self, indexes, **options)

    monkeypatch.setattr(_thinning.Thinned, "read", counted)
    with Opening(path) as opens:
        first = opens.first()
    blocks = {(rows[0] // 32, cols[0] // 16) for rows, cols in decoded}
    assert first.surface.heights.size < 50
    assert 512 * len(blocks) <= 10_000


def test_a_first_grid_that_is_coarse_for_want_of_time_is_followed_by_a_usual_one(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(opening, "_FIRST_SAMPLES", 1000)
    monkeypatch.setattr(opening, "_MOST_DECODED", 10_000)
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE, **LAYOUTS["tiles"])
    sizes = [stage.surface.heights.size for stage in stages(path)]
    assert len(sizes) == 3
    assert sizes[0] < 50
    assert 500 < sizes[1] <= 1000


def test_a_limit_of_memory_is_kept_and_said(tmp_path):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    (only,) = stages(path, memory_limit=14 * 10_000)
    assert only.is_final
    assert only.step == 2.0
    assert only.surface.heights.size <= 10_000
    assert only.note == (
        "one in 2 × 2 samples of 150 × 210; all of them take 441 kB of memory, "
        "and 140 kB may be taken"
    )


def test_doubles_take_more_memory(tmp_path):
    path = write_raster(tmp_path / "a.tif", terrain().astype(np.float64), transform=PLACE)
    (only,) = stages(path, memory_limit=14 * 10_000)
    assert only.surface.heights.size <= 14 * 10_000 / 26
    assert "take 819 kB of memory" in only.note


@pytest.mark.parametrize(("free", "step"), [(28 * 31_500, 1.0), (28 * 31_499, 2.0), (None, 1.0)])
def test_half_of_the_free_memory_may_be_taken(tmp_path, monkeypatch, free, step):
    monkeypatch.setattr(opening, "available_memory", lambda: free)
    (only,) = stages(write_raster(tmp_path / "a.tif", terrain(), transform=PLACE))
    assert only.step == step


def test_a_first_grid_without_any_triangle_is_passed_over(tmp_path, coarse):
    heights = np.full((150, 210), np.nan, np.float32)
    heights[61:79, 101:119] = 7.0
    found = stages(write_raster(tmp_path / "a.tif", heights, transform=PLACE))
    assert found[0].surface.n_samples > 2
    assert [stage.step for stage in found] == [5.0, 1.0]
    np.testing.assert_array_equal(found[-1].surface.heights, heights)


def test_a_mesh_is_opened_whole(tmp_path):
    mesh = bumpy(crs="EPSG:32616", west=5e5, north=4e6)
    rtin.write_mesh(mesh, tmp_path / "a.ply")
    (only,) = stages(tmp_path / "a.ply")
    np.testing.assert_array_equal(only.surface.vertices, mesh.vertices)
    np.testing.assert_array_equal(only.bounds, mesh.bounds[:, :2])
    assert only.crs == mesh.crs
    assert only.note == "96 triangles"


def test_a_mesh_in_degrees_comes_in_metres(tmp_path):
    mesh = in_degrees()
    rtin.write_mesh(mesh, tmp_path / "a.ply", keep_degrees=True)
    (only,) = stages(tmp_path / "a.ply")
    width, height = np.ptp(only.bounds, axis=0)
    # 8 and 6 cells of 3 seconds at 36.7° north
    assert (width, height) == pytest.approx((8 * 74.4, 6 * 92.5), rel=2e-3)
    a, _, c, _, e, f = tuple(only.to_crs)[:6]
    back = only.surface.vertices * [a, e, 1.0] + [c, f, 0.0]
    np.testing.assert_allclose(back, mesh.vertices, atol=1e-9)
    assert only.surface.crs is None


@pytest.mark.parametrize("memory_limit", [None, 14 * 10_000])
def test_the_finest_stage_can_be_had_at_once(tmp_path, coarse, memory_limit):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    last = stages(path, memory_limit=memory_limit)[-1]
    with Opening(path, memory_limit=memory_limit) as opens:
        only = opens.finest()
        opens.go_on(pytest.fail, pytest.fail)
    assert only.is_final
    np.testing.assert_array_equal(only.surface.heights, last.surface.heights)
    assert only.note == last.note


def test_points_of_the_file_come_to_the_surface(tmp_path):
    place = Affine(0.001, 0.0, 8.0, 0.0, -0.001, 47.0)
    path = write_raster(tmp_path / "a.tif", terrain(), transform=place, crs="EPSG:4326")
    (only,) = stages(path)
    x, y, z = only.from_crs((8.0105, 46.9695, 77.0))
    assert z == 77.0
    np.testing.assert_allclose((x, y), places(only.surface)[30, 10], atol=1e-6)


# The end


@pytest.mark.parametrize("name", ["a.tif", "a.npy"])
def test_no_stage_comes_after_closing(tmp_path, coarse, name):
    write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    np.save(tmp_path / "a.npy", terrain())
    path = tmp_path / name
    found, begun, go = [], threading.Event(), threading.Event()

    def wait(opened):
        found.append(opened)
        begun.set()
        go.wait(60)

    opens = Opening(path)
    opens.first()
    opens.go_on(wait, found.append)
    assert begun.wait(60)
    closing = threading.Thread(target=opens.close)
    closing.start()
    while not opens._is_closed.is_set():
        pass
    go.set()
    closing.join(60)
    assert not opens._thread.is_alive()
    assert [stage.is_final for stage in found] == [False]


def test_closing_ends_in_the_middle_of_a_file(tmp_path, coarse, monkeypatch):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE, **LAYOUTS["rows"])
    parts, found = [], []
    opens = Opening(path)
    opens.first()
    monkeypatch.setattr(_thinning, "_MOST_AT_ONCE", 300)
    require_open = opens._require_open

    def close_at_the_fifth():
        parts.append(None)
        if len(parts) == 5:
            opens._is_closed.set()
        require_open()

    monkeypatch.setattr(opens, "_require_open", close_at_the_fifth)
    opens.go_on(found.append, found.append)
    opens._thread.join(60)
    assert len(parts) == 5
    assert found == []


def test_what_goes_wrong_later_is_told(tmp_path, coarse):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE, **LAYOUTS["compressed"])
    found, done = [], threading.Event()
    with Opening(path) as opens:
        assert not opens.first().is_final
        path.write_bytes(path.read_bytes()[:2000])
        opens.go_on(found.append, lambda error: found.append(error) or done.set())
        assert done.wait(60)
    (error,) = found
    assert isinstance(error, OSError)
    assert "a.tif cannot be read" in str(error)
    assert len(str(error).splitlines()) == 1


def test_what_goes_wrong_with_a_stage_that_was_read_is_told(tmp_path, coarse):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    found, done = [], threading.Event()

    def stumble(opened):
        raise MemoryError("no room for a hierarchy")

    with Opening(path) as opens:
        opens.first()
        opens.go_on(stumble, lambda error: found.append(error) or done.set())
        assert done.wait(60)
    assert [str(error) for error in found] == ["no room for a hierarchy"]


def test_what_goes_wrong_after_closing_is_nobodys_business(tmp_path, coarse):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    opens = Opening(path)
    opens.first()

    def close_and_stumble(opened):
        opens.close()
        raise RuntimeError("there is no page any more")

    told = []
    opens.go_on(close_and_stumble, told.append)
    opens._thread.join(60)
    assert not opens._thread.is_alive()
    assert told == []


def test_nothing_goes_on_after_a_whole_one(tmp_path):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    with Opening(path) as opens:
        opens.first()
        opens.go_on(pytest.fail, pytest.fail)
        assert opens._thread is None


@pytest.mark.parametrize("name", ["a.tif", "a.npy", "a.ply"])
def test_a_missing_file_is_said_to_be_missing(tmp_path, name):
    with pytest.raises(FileNotFoundError) as error, Opening(tmp_path / name) as opens:
        opens.first()
    assert one_line(error)


@pytest.mark.parametrize("name", ["a.tif", "a.npy", "a.ply"])
def test_a_damaged_file_is_refused_in_one_line(tmp_path, name):
    (tmp_path / name).write_bytes(b"no raster and no mesh, ever" * 9)
    with pytest.raises((OSError, ValueError), match=name) as error, Opening(tmp_path / name) as one:
        one.first()
    assert one_line(error)


@pytest.mark.parametrize(
    ("options", "kind", "said"),
    [
        ({"band": 3}, ValueError, "band must be from 1 to 1, got 3"),
        ({"band": "1"}, TypeError, "band must be a whole number"),
        ({"encoding": "png"}, ValueError, "encoding must be"),
        ({"encoding": "terrarium"}, ValueError, "needs three or four bands"),
    ],
)
def test_bad_options_are_refused_as_by_read_grid(tmp_path, options, kind, said):
    path = write_raster(tmp_path / "a.tif", terrain(), transform=PLACE)
    with pytest.raises(kind, match=said) as error, Opening(path, **options) as opens:
        opens.first()
    assert one_line(error)


def test_a_raster_without_any_height_is_refused_by_name(tmp_path, coarse):
    path = write_raster(tmp_path / "a.tif", np.full((60, 80), np.nan, np.float32), transform=PLACE)
    with pytest.raises(ValueError, match=r"a\.tif: heights hold no value") as error:
        stages(path)
    assert one_line(error)


def test_a_picture_that_holds_no_heights_is_refused(tmp_path, coarse):
    colours = np.random.default_rng(0).integers(0, 256, (3, 90, 90)).astype(np.uint8)
    path = write_raster(tmp_path / "a.tif", colours, transform=PLACE)
    with pytest.raises(ValueError, match="heights on Earth neither as terrain-RGB"):
        stages(path)


def test_the_metres_of_a_stage_are_those_of_a_grid():
    """The one formula serves both."""
    grid = Grid(terrain(), Affine(0.01, 0.001, 8.0, 0.002, -0.01, 47.0), "EPSG:4326")
    metric = grid.in_metres()
    np.testing.assert_allclose(places(metric).mean(axis=(0, 1)), 0.0, atol=1e-6)
    assert metric.crs is None
