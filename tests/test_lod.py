"""`LevelOfDetail` against its naive twin, what it promises of every view, and starting afresh."""

import copy
import math
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from affine import Affine
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import naive
import rtin
import surfaces
import terrains
from rtin import validity
from rtin.lod import GROWTH

SLACK = 1e-6  # of a box, for bounds kept as float32
TRANSFORMS = surfaces.TRANSFORMS


# --- views --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class View:
    """From where, how sharply, and between which planes a terrain is seen."""

    eye: tuple[float, float, float]
    field_of_view: float = 60.0
    height: int = 1080
    frustum: object = None

    @property
    def options(self):
        return vars(self)

    @property
    def scale(self):
        """Pixels of a length of 1 at a distance of 1."""
        return self.height / (2.0 * math.tan(math.radians(self.field_of_view) / 2.0))

    def pixels(self, lengths, points):
        """What lengths at some points take; a length of 0 is nothing from anywhere."""
        with np.errstate(divide="ignore", invalid="ignore"):
            taken = lengths * self.scale / np.linalg.norm(points - self.eye, axis=-1)
        return np.where(lengths == 0.0, 0.0, taken)

    def sees(self, points):
        if self.frustum is None:
            return np.ones(points.shape[:-1], bool)
        return (points @ self.frustum[:, :3].T + self.frustum[:, 3] >= 0.0).all(axis=-1)


def samples_of(grid):
    """x, y, z of all samples, shape (rows, cols, 3)."""
    a, b, c, d, e, f = tuple(grid.transform)[:6]
    row, col = np.indices(grid.shape)
    x, y = a * col + b * row + c, d * col + e * row + f
    return np.stack([x, y, grid.heights.astype(np.float64)], axis=-1)


def size_of_cell(grid):
    return math.sqrt(abs(grid.transform.determinant))


@st.composite
def views(draw, grid, frusta=True):
    """From above, from within, from below, from far away and from a sample itself."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    samples = samples_of(grid)[~np.isnan(grid.heights)]
    middle, spread = samples.mean(axis=0), np.ptp(samples, axis=0) + size_of_cell(grid)
    kind = draw(st.sampled_from(["around", "within", "at a sample", "below", "far away"]))
    eye = middle + rng.uniform(-1.0, 1.0, 3) * spread
    if kind == "at a sample":
        eye = samples[rng.integers(len(samples))]
    elif kind == "around":
        eye[2] = middle[2] + rng.uniform(0.5, 3.0) * spread.max()
    elif kind == "below":
        eye[2] = samples[:, 2].min() - rng.uniform(0.0, 1.0) * spread.max()
    elif kind == "far away":
        eye = middle + rng.uniform(-100.0, 100.0, 3) * spread.max()
    view = View(
        tuple(eye.tolist()),
        field_of_view=draw(st.sampled_from([60.0, 20.0, 110.0])),
        height=draw(st.sampled_from([1080, 300])),
    )
    if not frusta or draw(st.booleans()):
        return view
    target = samples[rng.integers(len(samples))] + rng.uniform(-1.0, 1.0, 3)
    planes = rtin.frustum(eye, target, field_of_view=view.field_of_view, aspect=rng.uniform(0.3, 3))
    return replace(view, frustum=planes)


@st.composite
def grids(draw, largest=11, holes=True, transforms=tuple(TRANSFORMS)):
    heights = draw(terrains.rasters(largest, holes))
    if draw(st.booleans()):
        heights = heights * draw(st.sampled_from([1e-3, 1 / 3, 1e4]))  # of float64, most of them
    return rtin.Grid(heights, TRANSFORMS[draw(st.sampled_from(transforms))])


@st.composite
def pixel_errors(draw, grid, view):
    """From those that need nearly all vertices to those that need hardly any."""
    valid = samples_of(grid)[~np.isnan(grid.heights)]
    length = np.ptp(valid[:, 2]) + 0.1 * size_of_cell(grid)
    at = np.median(np.linalg.norm(valid - view.eye, axis=1))
    share = draw(st.sampled_from([0.0, 0.01, 0.1, 0.3, 0.6, 1.0, 2.0, 5.0]))
    return float(share * view.scale * length / max(at, size_of_cell(grid)))


@st.composite
def scenes(draw, **options):
    """A grid, a view of it, and a tolerance in pixels."""
    frusta = options.pop("frusta", True)
    grid = draw(grids(**options))
    view = draw(views(grid, frusta))
    return grid, view, draw(pixel_errors(grid, view))


def vertex_set(mesh, grid):
    return set(naive.places(mesh, grid))


def same_bytes(mesh, other):
    return (
        mesh.vertices.tobytes() == other.vertices.tobytes()
        and mesh.triangles.tobytes() == other.triangles.tobytes()
    )


# --- against the naive twin ---------------------------------------------------------------------


def naive_triangles(grid, weights, tolerance):
    """Those of the twin's closed set; None where it hangs on the last digits of a weight."""
    size = naive.lattice_size(grid.shape)
    sure, perhaps = (
        naive.kept_above(weights[i], tolerance * (1.0 + sign * 1e-6), size)
        for i, sign in ((0, 1), (-1, -1))
    )
    if sure != perhaps:
        return None
    assert all(parent in sure for v in sure for parent in naive.parents(v, size))
    kept, triangles = naive.retriangulate(sure, size)
    assert kept == sure  # it was closed
    return naive.visible(grid.heights, triangles)


@settings(max_examples=40)
@given(grids(transforms=("north up",)), st.sampled_from([0.0, 0.5, 2.0, 3.5, 10.0, 40.0]))
def test_keeps_what_the_twin_keeps_for_a_tolerance(grid, tolerance):
    weights = naive.weights_by_height(grid.heights, GROWTH)
    tolerance = tolerance or rounding(grid)
    triangles = naive_triangles(grid, [weights], tolerance)
    assume(triangles is not None)
    mesh = rtin.LevelOfDetail(grid).mesh(max_error=tolerance)
    assert naive.triangles_of(mesh, grid) == triangles


@settings(max_examples=80)
@given(scenes(transforms=tuple(terrains.TRANSFORMS)))
def test_keeps_what_the_twin_keeps_for_an_eye(scene):
    grid, view, pixel_error = scene
    pixel_error = pixel_error or 1e-9
    planes = np.empty((0, 4)) if view.frustum is None else view.frustum
    weights = [
        naive.weights_by_pixels(grid, GROWTH, view.eye, view.scale, planes, slack)
        for slack in (0.0, SLACK)
    ]
    triangles = naive_triangles(grid, weights, pixel_error)
    assume(triangles is not None)
    mesh = rtin.LevelOfDetail(grid).mesh(pixel_error=pixel_error, **view.options)
    assert naive.triangles_of(mesh, grid) == triangles


@pytest.mark.parametrize("holes", terrains.HOLES)
@pytest.mark.parametrize("shape", terrains.SHAPES, ids=str)
def test_keeps_what_the_twin_keeps_on_every_shape_and_hole(shape, holes):
    for number, terrain in enumerate(["waves", "plateaus", "spike"]):
        heights = terrains.pierced(terrains.GALLERY[terrain](shape), terrains.HOLES[holes](shape))
        if not terrains.has_a_triangle(heights):
            continue
        grid = rtin.Grid(heights)
        tolerance = [0.3, 3.1, 20.7][number]
        weights = naive.weights_by_height(grid.heights, GROWTH)
        mesh = rtin.LevelOfDetail(grid).mesh(max_error=tolerance)
        assert naive.triangles_of(mesh, grid) == naive_triangles(grid, [weights], tolerance)


@pytest.mark.parametrize("holes", ["none", "pond"])
def test_keeps_what_the_twin_keeps_of_triangles_too_large_to_search_through(holes):
    shape = (65, 50)
    heights = terrains.waves(shape) / 4 + terrains.noise(shape) / 64
    heights = terrains.pierced(heights, terrains.HOLES[holes](shape))
    lod = rtin.LevelOfDetail(rtin.Grid(np.float32(heights)))
    lod.update(slice(30, 34), slice(8, 11), heights[30:34, 8:11] + 9.0)
    weights = naive.weights_by_height(lod.grid.heights, GROWTH)
    finite = sorted(weight for weight in weights.values() if weight < math.inf)
    for tolerance in (0.4, 2.3, 7.7, 12.1, finite[-1] * 0.99):
        triangles = naive_triangles(lod.grid, [weights], tolerance)
        assert naive.triangles_of(lod.mesh(max_error=tolerance), lod.grid) == triangles


def test_a_sample_alone_among_voids_counts_for_the_large_triangles_over_it():
    heights = np.full((65, 65), np.nan)
    heights[::32, ::32] = 0.0
    for row, col in ((5, 37), (3, 9), (50, 11), (41, 60)):
        heights[row, col] = 1000.0
        grid, view = rtin.Grid(heights.copy()), View((32.0, -32.0, 1e5))
        lod = rtin.LevelOfDetail(grid)
        weights = naive.weights_by_pixels(grid, GROWTH, view.eye, view.scale, np.empty((0, 4)))
        for length in (50.0, 500.0, 950.0, 1010.0, 1200.0):
            pixel_error = view.scale * length / 1e5
            mesh = lod.mesh(pixel_error=pixel_error, **view.options)
            assert_keeps_its_promise(mesh, grid, view, pixel_error)
            assert naive.triangles_of(mesh, grid) == naive_triangles(grid, [weights], pixel_error)
        heights[row, col] = np.nan


def roughness():
    return np.random.default_rng(8).normal(0.0, 10.0, (65, 65))


def tents():
    """Smooth between samples 16 apart, and rough in one quarter: there the search begins."""
    rng = np.random.default_rng(2)
    heights = np.zeros((65, 65))
    heights[::64, ::64] = rng.normal(0.0, 30.0, (2, 2))
    for vertex in naive.bisections(64):
        one, other = naive.ends(vertex, 64)
        is_coarse = naive.level_spacing(vertex, 64) >= 16
        heights[vertex] = (heights[one] + heights[other]) / 2.0 + rng.normal(0.0, 30.0) * is_coarse
    heights[:32, :32] += terrains.noise((32, 32))
    return heights


@pytest.mark.parametrize("holes", ["none", "one sample", "scattered"])
@pytest.mark.parametrize("terrain", [roughness, tents])
def test_own_errors_are_the_largest_of_all_samples(terrain, holes):
    """Ancestors hide them in a mesh: parts of large triangles that are skipped show here only."""
    heights = terrains.pierced(terrain(), terrains.HOLES[holes]((65, 65)))
    grid = rtin.Grid(np.float32(heights))
    lod = rtin.LevelOfDetail(grid)
    size, exact = 64, naive.exact_heights(grid.heights)
    found, expected = [], []
    for row, col in naive.bisections(size):
        spacing = naive.level_spacing((row, col), size)
        level, is_centre = spacing.bit_length() - 1, bool(row & spacing and col & spacing)
        first, width, n_rows = lod._layout[level, 0 if is_centre else 3 :][:3]
        i, j = row // spacing // (1 + is_centre), col // spacing // 2
        if spacing > 1 and i < n_rows and j < width:
            found.append(lod._own[first + i * width + j])
            expected.append(float(naive.own_error((row, col), exact, size)))
    assert max(expected) > 0.0
    assert (np.array(found) >= expected).all()
    np.testing.assert_allclose(found, expected, rtol=3e-7, atol=1e-44)


@given(st.floats(1e-30, 1e30))
def test_boxes_hold_heights_that_float32_does_not(scale):
    heights = terrains.noise((9, 9)) * scale
    _, low, high = rtin.LevelOfDetail(rtin.Grid(heights))._bounds.T.astype(np.float64)
    assert low.min() <= heights.min() <= heights.max() <= high.max()
    holes = heights.copy()
    holes[1::2, 1::2] = np.nan
    _, low, high = rtin.LevelOfDetail(rtin.Grid(holes))._bounds.T.astype(np.float64)
    assert np.nanmin(low) <= np.nanmin(holes) <= np.nanmax(holes) <= np.nanmax(high)


# --- the promise --------------------------------------------------------------------------------


def rounding(grid):
    """Of measured heights, by digits that heights and places lack."""
    digits = np.abs(samples_of(grid)[..., :2]).max() / size_of_cell(grid)
    return 1e-15 * (4.0 + digits) * np.nanmax(np.abs(grid.heights))


def assert_keeps_its_promise(mesh, grid, view, pixel_error):
    """Every sample in sight that the mesh covers is within the tolerance, by plain geometry."""
    errors = np.nan_to_num(np.abs(naive.surface_minus_samples(mesh, grid)))
    samples = samples_of(grid)
    seen = ~np.isnan(grid.heights) & view.sees(samples)
    pixels = view.pixels((errors - rounding(grid)).clip(min=0.0), samples)
    assert pixels[seen].max(initial=0.0) <= pixel_error * (1.0 + 1e-9)


@settings(max_examples=120)
@given(scenes())
def test_every_sample_in_sight_is_within_the_pixel_error(scene):
    grid, view, pixel_error = scene
    mesh = rtin.LevelOfDetail(grid).mesh(pixel_error=pixel_error, **view.options)
    assert_keeps_its_promise(mesh, grid, view, pixel_error)
    validity.check(mesh)


@settings(max_examples=120)
@given(scenes(), st.data())
def test_frames_keep_the_promise_too_while_they_morph(scene, data):
    grid, view, pixel_error = scene
    pixel_error = data.draw(critical_tolerances(grid, view)) or pixel_error
    frame = rtin.LevelOfDetail(grid).frame(pixel_error=pixel_error, **view.options)
    assert frame.pixel_error == pixel_error
    assert_keeps_its_promise(frame.mesh, grid, view, pixel_error)
    assert_keeps_its_promise(frame.morphed, grid, view, pixel_error)


@pytest.mark.parametrize("pixel_error", [2.0, 4.0, 6.0, 8.0, 12.0, 20.0])
def test_keeps_its_promise_where_cells_are_far_from_right_angled(pixel_error):
    # Along their short diagonal samples are closer than rows or columns are.
    grid = rtin.Grid(terrains.noise((17, 17)) / 50, Affine(1.0, 0.95, 0.0, 0.0, -0.3, 0.0))
    for corner in ((-60.0, 76.0), (76.0, -60.0)):  # column and row
        view = View((*(grid.transform @ corner), 0.0))
        mesh = rtin.LevelOfDetail(grid).mesh(pixel_error=pixel_error, **view.options)
        assert_keeps_its_promise(mesh, grid, view, pixel_error)


@pytest.mark.parametrize("share", [1.001, 1.02])
def test_nothing_beside_a_void_is_drawn_towards_what_was_not_there(share):
    row, col = np.indices((5, 5))
    heights = 1000.0 - 500.0 * np.maximum(abs(row - 2), abs(col - 2))
    heights[1, 1] += 50.0
    heights[0, 4] = heights[4, 0] = np.nan  # apexes of the vertex in the middle
    grid, view = rtin.Grid(heights), View((2.0, -2.0, 200_000.0))
    weights = naive.weights_by_pixels(grid, GROWTH, view.eye, view.scale, np.empty((0, 4)))
    pixel_error = share * weights[2, 2]
    frame = rtin.LevelOfDetail(grid).frame(pixel_error=pixel_error, **view.options)
    assert frame.mesh.n_triangles == 2
    assert_keeps_its_promise(frame.morphed, grid, view, pixel_error)


@st.composite
def critical_tolerances(draw, grid, view):
    """Tolerances at which some vertex has come a part of its way; None where there is none."""
    planes = np.empty((0, 4)) if view.frustum is None else view.frustum
    weights = naive.weights_by_pixels(grid, GROWTH, view.eye, view.scale, planes)
    finite = sorted({weight for weight in weights.values() if 0.0 < weight < math.inf})
    share = draw(st.floats(0.0, 1.0))
    return finite[int(share * (len(finite) - 1))] * draw(st.floats(1.0, 1.07)) if finite else None


@settings(max_examples=80)
@given(grids(), terrains.tolerances | st.just(math.inf))
def test_a_tolerance_in_height_holds_everywhere_and_covers_all(grid, tolerance):
    mesh = rtin.LevelOfDetail(grid).mesh(max_error=tolerance)
    validity.check(mesh)
    errors = np.abs(naive.surface_minus_samples(mesh, grid))
    assert np.nanmax(errors) <= tolerance + rounding(grid)
    at = naive.places(mesh, grid)
    parts = [
        frozenset(part)
        for a, b, apex in mesh.triangles
        for part in naive.finest_parts((at[apex], at[a], at[b]))
    ]
    assert len(parts) == len(set(parts))
    assert set(parts) == naive.finest(grid.heights)


@settings(max_examples=80)
@given(scenes(frusta=False))
def test_an_outline_is_off_by_no_more_than_the_pixel_error(scene):
    grid, view, pixel_error = scene
    mesh = rtin.LevelOfDetail(grid).mesh(pixel_error=pixel_error, **view.options)
    covered = ~np.isnan(naive.surface_minus_samples(mesh, grid))
    whole = np.zeros(grid.shape, bool)
    if corners := naive.corners_of(naive.finest(grid.heights)):
        whole[tuple(np.transpose(list(corners)))] = True
    left_out = np.argwhere(whole & ~covered)
    if not len(left_out):
        return
    beyond = outside_places(grid, whole)
    for row, col in left_out:
        here = samples_of(grid)[row, col]
        gap = min(np.linalg.norm(np.subtract(here[:2], grid.transform @ (c, r))) for r, c in beyond)
        assert view.pixels(np.float64(gap), here) <= pixel_error * (1.0 + 1e-9)


def outside_places(grid, whole):
    """Places on the lattice, and a row or column beyond, without a height or a triangle."""
    size = naive.lattice_size(grid.shape)
    return [
        (row, col)
        for row in range(-1, size + 2)
        for col in range(-1, size + 2)
        if not (0 <= row < grid.shape[0] and 0 <= col < grid.shape[1] and whole[row, col])
    ]


# --- more and fewer vertices --------------------------------------------------------------------


@given(scenes(), st.floats(0.0, 1.0))
def test_a_smaller_pixel_error_keeps_a_superset(scene, share):
    grid, view, pixel_error = scene
    assume(not grid.has_voids)
    lod = rtin.LevelOfDetail(grid)
    finer, coarser = (
        vertex_set(lod.mesh(pixel_error=e, **view.options), grid)
        for e in (share * pixel_error, pixel_error)
    )
    assert finer >= coarser


@given(grids(), terrains.tolerances, terrains.tolerances)
def test_a_smaller_tolerance_keeps_a_superset(grid, one, other):
    lod = rtin.LevelOfDetail(grid)
    finer, coarser = (vertex_set(lod.mesh(max_error=e), grid) for e in sorted([one, other]))
    assert finer >= coarser


@given(scenes())
def test_a_frustum_only_leaves_vertices_out(scene):
    grid, view, pixel_error = scene
    assume(not grid.has_voids and view.frustum is not None)
    lod = rtin.LevelOfDetail(grid)
    all_round = lod.mesh(pixel_error=pixel_error, **replace(view, frustum=None).options)
    within = lod.mesh(pixel_error=pixel_error, **view.options)
    assert vertex_set(within, grid) <= vertex_set(all_round, grid)


@given(scenes(), st.sampled_from([2.0, 8.0, 0.25]))
def test_only_pixels_for_a_length_at_a_distance_count(scene, factor):
    grid, view, pixel_error = scene
    lod = rtin.LevelOfDetail(grid)
    mesh = lod.mesh(pixel_error=pixel_error, **view.options)
    larger = replace(view, height=view.height * factor)
    assert same_bytes(mesh, lod.mesh(pixel_error=pixel_error * factor, **larger.options))


@given(scenes(), st.sampled_from([2.0, 8.0, 0.125]))
def test_drawn_higher_is_as_if_it_were_higher(scene, times):
    grid, view, pixel_error = scene
    higher = rtin.LevelOfDetail(rtin.Grid(grid.heights * times, grid.transform))
    lod = rtin.LevelOfDetail(grid)
    for asked in ({"pixel_error": pixel_error}, {"max_triangles": 40}):
        frame = lod.frame(exaggeration=times, **asked, **view.options)
        other = higher.frame(**asked, **view.options)
        scaled = frame.morphed.vertices * (1.0, 1.0, times)
        np.testing.assert_array_equal(scaled, other.morphed.vertices)
        assert frame.pixel_error == other.pixel_error


def rolling(shape=(65, 65), noise=0.3, **options):
    """Hills with all sizes of detail: hardly two vertices weigh the same."""
    row, col = np.indices(shape)
    hills = 12.0 * np.sin(row / 11.0) * np.cos(col / 14.0) + 3.0 * np.sin((row + 2 * col) / 5.0)
    fine = np.random.default_rng(3).normal(0.0, noise, shape)
    return rtin.Grid(np.where(terrains.HOLES[options.pop("holes", "none")](shape), np.nan,
                              np.float32(hills + fine)), **options)  # fmt: skip


def test_what_is_far_or_behind_is_coarser():
    grid = rolling()
    lod = rtin.LevelOfDetail(grid)
    eye = (20.0, -32.0, 30.0)
    all_round = lod.mesh(eye, pixel_error=20.0)
    eastward = lod.mesh(eye, pixel_error=20.0, frustum=rtin.frustum(eye, (64.0, -32.0, 10.0)))
    near = np.abs(all_round.vertices[:, 0] - 20.0) < 16.0
    assert near.sum() > 1.2 * (~near).sum()
    assert (eastward.vertices[:, 0] < 10.0).sum() < 0.1 * (all_round.vertices[:, 0] < 10.0).sum()


@pytest.mark.parametrize("tolerance", [0.3, 1.0, 4.0])
def test_takes_few_vertices_more_than_the_least_mesh(tolerance):
    grid = rtin.Grid(rtin.samples.jacksboro_fault().heights[:257, :257])
    least = rtin.coarsen(grid, max_error=10.0 * tolerance).n_vertices
    mesh = rtin.LevelOfDetail(grid).mesh(max_error=10.0 * tolerance)
    assert least <= mesh.n_vertices < 1.25 * least


def test_a_lossless_mesh_has_no_error_at_all():
    for heights in (terrains.noise((17, 23)), terrains.noise((17, 23)) / 3.0):
        grid = rtin.Grid(heights)
        lod = rtin.LevelOfDetail(grid)
        for mesh in (lod.mesh(max_error=0), lod.mesh((5.0, 5.0, 99.0), pixel_error=0)):
            assert rtin.vertical_error(mesh, grid).max <= rounding(grid)


def test_any_error_is_allowed_but_what_the_eye_is_in():
    lod = rtin.LevelOfDetail(rolling())
    far = lod.frame((30.0, -30.0, 500.0), pixel_error=math.inf)
    assert far.mesh.n_triangles == 2
    within = lod.frame((30.0, -30.0, 0.0), pixel_error=math.inf)
    assert 2 < within.mesh.n_triangles < 200
    least = lod.frame((30.0, -30.0, 0.0), max_triangles=2)
    assert least.mesh.n_triangles == 2
    for frame in (far, within, least):
        assert frame.pixel_error == math.inf
        assert (frame.weights == 1.0).all()


def test_flat_terrain_needs_two_triangles():
    lod = rtin.LevelOfDetail(rtin.Grid(np.full((33, 33), 7.0)))
    for options in ({"max_error": 0}, {"eye": (3, -3, 8)}, {"max_triangles": 999}):
        assert lod.mesh(**options).n_triangles == 2


# --- the mesh as a whole ------------------------------------------------------------------------


@pytest.mark.parametrize("transform", TRANSFORMS)
@pytest.mark.parametrize("holes", terrains.HOLES)
def test_is_a_right_mesh_under_every_transform(transform, holes):
    shape = (17, 23)
    heights = terrains.pierced(terrains.waves(shape), terrains.HOLES[holes](shape))
    grid = rtin.Grid(heights, TRANSFORMS[transform])
    lod = rtin.LevelOfDetail(grid)
    eye = (*(grid.transform @ (4.0, 5.0)), 60.0)
    frame = lod.frame(eye, pixel_error=30.0 * size_of_cell(grid))
    meshes = {
        "by height": lod.mesh(max_error=4.0),
        "by pixels": frame.mesh,
        "morphed": frame.morphed,
    }
    for name, mesh in meshes.items():
        validity.check(mesh)
        assert_has_no_t_junction(mesh, grid)
        assert (mesh.signed_areas() > 0.0).all()
        at = np.array(naive.places(mesh, grid))
        x, y = grid.transform @ (at[:, 1].astype(float), at[:, 0].astype(float))
        np.testing.assert_allclose(mesh.vertices[:, :2], np.column_stack([x, y]), rtol=1e-14)
        a, b, apex = (at[corner] for corner in mesh.triangles.T)
        legs = a - apex, b - apex
        assert ((legs[0] * legs[1]).sum(axis=1) == 0).all()
        assert ((legs[0] ** 2).sum(axis=1) == (legs[1] ** 2).sum(axis=1)).all()
        if name != "morphed":
            np.testing.assert_array_equal(mesh.vertices[:, 2], grid.heights[tuple(at.T)])


def assert_has_no_t_junction(mesh, grid):
    """No vertex lies inside an edge: looked for at all places of the lattice on every edge."""
    at = np.array(naive.places(mesh, grid))
    vertices = set(map(tuple, at.tolist()))
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    for a, b in at[np.unique(edges, axis=0)]:
        n_steps = np.abs(b - a).max()
        step = (b - a) // n_steps
        assert not any(tuple((a + k * step).tolist()) in vertices for k in range(1, n_steps))


@pytest.mark.parametrize("shape", [(65, 65), (40, 65), (50, 33)], ids=str)
def test_without_voids_is_a_disc_bounded_by_the_raster(shape):
    grid = rolling(shape)
    lod = rtin.LevelOfDetail(grid)
    eye = (30.0, -20.0, 25.0)
    planes = rtin.frustum(eye, (0.0, 0.0, 0.0))
    for mesh in (lod.mesh(max_error=1.5), lod.mesh(eye, max_triangles=900, frustum=planes)):
        edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, counts = np.unique(edges, axis=0, return_counts=True)
        assert counts.max() == 2
        assert mesh.n_vertices - len(edges) + mesh.n_triangles == 1
    mesh = lod.mesh(max_error=1.5)
    assert mesh.signed_areas().sum() == pytest.approx((shape[0] - 1) * (shape[1] - 1), rel=1e-12)


def test_vertices_come_coarsest_first():
    grid = rolling()
    at = naive.places(rtin.LevelOfDetail(grid).mesh((9.0, -9.0, 40.0), pixel_error=5.0), grid)
    spacings = [naive.level_spacing(place, 64) for place in at]
    assert spacings == sorted(spacings, reverse=True)


def test_carries_the_crs():
    grid = rolling((9, 9), crs="EPSG:2056")
    frame = rtin.LevelOfDetail(grid).frame((1.0, 1.0, 1.0))
    assert frame.mesh.crs == frame.morphed.crs == grid.crs


# --- budgets ------------------------------------------------------------------------------------


@settings(max_examples=60)
@given(scenes(), st.integers(2, 300))
def test_a_budget_for_an_eye_is_held_and_tight(scene, budget):
    grid, view, _ = scene
    lod = rtin.LevelOfDetail(grid)
    frame = lod.frame(max_triangles=budget, **view.options)
    assert frame.mesh.n_triangles <= budget
    assert same_bytes(frame.mesh, lod.mesh(max_triangles=budget, **view.options))
    if 0.0 < frame.pixel_error < math.inf:
        above, below = (
            lod.frame(pixel_error=frame.pixel_error * (1.0 + step), **view.options).mesh
            for step in (1e-9, -1e-9)
        )
        assert same_bytes(above, frame.mesh)
        assert below.n_triangles > budget
        assert_keeps_its_promise(frame.mesh, grid, view, frame.pixel_error)
        assert_keeps_its_promise(frame.morphed, grid, view, frame.pixel_error)


@settings(max_examples=30)
@given(grids())
def test_a_budget_for_no_eye_is_the_smallest_tolerance_that_fits(grid):
    lod = rtin.LevelOfDetail(grid)
    weights = naive.weights_by_height(grid.heights, GROWTH).values()
    finite = sorted({weight for weight in weights if weight < math.inf} | {0.0}, reverse=True)
    meshes = [lod.mesh(max_error=w * (1.0 + 1e-6)) for w in finite[:: 1 + len(finite) // 6]]
    outline = meshes[0].n_triangles
    assume(outline >= 2)
    for mesh in meshes:
        budget = mesh.n_triangles
        assert same_bytes(lod.mesh(max_triangles=budget), mesh)
        if budget > outline:
            assert outline <= lod.mesh(max_triangles=budget - 1).n_triangles < budget
    with pytest.raises(ValueError, match="max_triangles must be at least"):
        lod.mesh(max_triangles=outline - 1)


def test_earlier_budgets_have_no_say():
    grid = rolling(holes="pond")
    used = rtin.LevelOfDetail(grid)
    rng = np.random.default_rng(4)
    for budget in (50, 3000, 200, 201, 10**6, 40, 900):
        eye = rng.uniform((0.0, -64.0, 10.0), (64.0, 0.0, 100.0))
        for options in ({}, {"frustum": rtin.frustum(eye, (32.0, -32.0, 0.0))}):
            fresh = rtin.LevelOfDetail(grid)
            one, other = (lod.mesh(eye, max_triangles=budget, **options) for lod in (used, fresh))
            assert same_bytes(one, other)
        if budget > 700:  # enough for the outline
            one, other = (lod.mesh(max_triangles=budget) for lod in (used, fresh))
            assert same_bytes(one, other)


def around_voids(distance):
    """A terrain where finer is not always more triangles, an eye above, and what vertices weigh."""
    rng = np.random.default_rng(7)
    heights = rng.normal(0.0, 1e-3, (9, 9))
    heights[rng.random((9, 9)) < 0.15] = np.nan
    grid, view = rtin.Grid(heights), View((4.0, -4.0, distance))
    weights = naive.weights_by_pixels(grid, GROWTH, view.eye, view.scale, np.empty((0, 4)))
    return grid, view, np.unique([w for w in weights.values() if 0.0 < w < math.inf])


@pytest.mark.parametrize("distance", [20.0, 2000.0])
def test_every_tolerance_larger_than_a_budgets_keeps_it(distance):
    grid, view, weights = around_voids(distance)
    lod = rtin.LevelOfDetail(grid)
    sizes = np.array([lod.mesh(view.eye, pixel_error=w * 1.0000001).n_triangles for w in weights])
    assert (np.diff(sizes) > 0).any()
    for budget in range(2, sizes.max()):
        kept = lod.frame(view.eye, max_triangles=budget).pixel_error / GROWTH**2
        assert (sizes[weights > 1.000001 * kept] <= budget).all()


def test_a_search_for_a_budget_ends_at_one_tolerance_wherever_it_starts():
    grid, view, weights = around_voids(60.0)
    lod = rtin.LevelOfDetail(grid)
    for budget in range(2, 50):
        found = set()
        for weight in weights:
            lod._guesses[1] = 0.9999999 * weight
            found.add(lod.frame(view.eye, max_triangles=budget).pixel_error)
        assert len(found) == 1


@pytest.mark.parametrize("budget", [2**62, 2**63 - 1, 10**30, np.uint64(2**64 - 1)])
def test_a_budget_may_be_any_whole_number(budget):
    lod = rtin.LevelOfDetail(rolling((17, 17)))
    assert same_bytes(lod.mesh(max_triangles=budget), lod.mesh(max_error=0.0))
    frame = lod.frame((8.0, -8.0, 9.0), max_triangles=budget)
    assert frame.pixel_error == 0.0
    assert frame.mesh.n_triangles == 512


def test_of_equals_all_or_none_are_kept():
    heights = np.zeros((17, 17))
    heights[1::4, 1::4] = heights[3::4, 3::4] = 5.0
    lod = rtin.LevelOfDetail(rtin.Grid(heights))
    everything = lod.mesh(max_error=0).n_triangles
    assert lod.mesh(max_triangles=everything).n_triangles == everything
    assert lod.mesh(max_triangles=everything - 1).n_triangles < everything - 8


def test_walks_over_no_more_than_it_puts_out(monkeypatch):
    from rtin._kernels import lod as kernels

    walked, walk = [], kernels.walk
    monkeypatch.setattr(kernels, "walk", lambda *args: walked.append(walk(*args)) or walked[-1])
    grid = rolling((257, 257))
    lod = rtin.LevelOfDetail(grid)
    eye = (128.0, -100.0, 60.0)
    planes = rtin.frustum(eye, (0.0, 0.0, 0.0))
    for pixel_error in (1.0, 10.0, 100.0):
        walked.clear()
        mesh = lod.mesh(eye, pixel_error=pixel_error, frustum=planes)
        assert [len(places) for places, *_ in walked] == [mesh.n_vertices]
    lod.mesh(eye, max_triangles=3000)
    walked.clear()
    mesh = lod.mesh((129.0, -100.0, 60.0), max_triangles=3000)
    assert sum(len(places) for places, *_ in walked) < 2 * mesh.n_vertices


# --- frames -------------------------------------------------------------------------------------


@settings(max_examples=60)
@given(scenes(transforms=tuple(terrains.TRANSFORMS)), st.data())
def test_weights_say_how_far_a_vertex_is_above_the_tolerance(scene, data):
    grid, view, pixel_error = scene
    pixel_error = data.draw(critical_tolerances(grid, view)) or pixel_error or 1.0
    frame = rtin.LevelOfDetail(grid).frame(pixel_error=pixel_error, **view.options)
    planes = np.empty((0, 4)) if view.frustum is None else view.frustum
    taken = naive.weights_by_pixels(grid, GROWTH, view.eye, view.scale, planes)
    hierarchy = naive.saturated(grid.heights, GROWTH)
    size = naive.lattice_size(grid.shape)
    at = naive.places(frame.mesh, grid)
    weight_at = dict(zip(at, frame.weights, strict=True))
    assert frame.weights.dtype == np.float32
    assert frame.coarser.dtype == np.float64
    for place, weight, coarser in zip(at, frame.weights, frame.coarser, strict=True):
        ends = naive.ends(place, size)
        if ends is None or hierarchy[place][1]:
            assert coarser == grid.heights[place]
            continue
        assert coarser == pytest.approx(np.mean([grid.heights[end] for end in ends], dtype=float))
        share = (GROWTH**2 * taken[place] / pixel_error - 1.0) / (GROWTH**2 - 1.0)
        if taken[place] < math.inf:
            assert weight == pytest.approx(np.clip(share, 0.0, 1.0), abs=2e-3)
        if weight < 1.0:
            assert all(weight_at.get(end, 1.0) == 1.0 for end in ends)


def test_a_frame_is_the_mesh_for_its_tolerance():
    lod = rtin.LevelOfDetail(rolling())
    frame = lod.frame((30.0, -30.0, 50.0), pixel_error=9.0)
    assert same_bytes(frame.mesh, lod.mesh((30.0, -30.0, 50.0), pixel_error=9.0 / GROWTH**2))
    assert frame.weights.shape == frame.coarser.shape == (frame.mesh.n_vertices,)
    z = frame.morphed.vertices[:, 2]
    own = frame.mesh.vertices[:, 2]
    np.testing.assert_allclose(z, frame.weights * own + (1 - frame.weights) * frame.coarser)
    np.testing.assert_array_equal(frame.morphed.vertices[:, :2], frame.mesh.vertices[:, :2])
    np.testing.assert_array_equal(frame.morphed.triangles, frame.mesh.triangles)
    is_moving = (frame.weights > 0.0) & (frame.weights < 1.0)
    assert 5 < is_moving.sum() < 0.3 * len(z)


def test_a_lossless_frame_does_not_move():
    frame = rtin.LevelOfDetail(rolling((17, 17))).frame((3.0, 3.0, 30.0), pixel_error=0.0)
    assert (frame.weights == 1.0).all()
    assert same_bytes(frame.morphed, frame.mesh)


def surface(frame, grid):
    """Heights of the surface drawn, at all samples."""
    return rtin.vertical_error(frame.morphed, grid).field + grid.heights


def pixels_between(one, other, grid, view):
    """How far the surfaces drawn of two frames are from each other, as seen."""
    return view.pixels(np.abs(surface(one, grid) - surface(other, grid)), samples_of(grid)).max()


FILLED = {"rolling": rolling((33, 33), 1.0), "noise": rtin.Grid(terrains.noise((33, 33)) / 30)}
STEPS = {
    "a tolerance": {"pixel_error": 25.0},
    "a fine tolerance": {"pixel_error": 3.0},
    "a budget": {"max_triangles": 400},
}


@pytest.mark.parametrize("options", STEPS)
@pytest.mark.parametrize("terrain", FILLED)
def test_nothing_pops_where_vertices_come_and_go(terrain, options):
    """Bisect moves of the eye, down to where some vertex comes or goes: the surface stays."""
    grid, options = FILLED[terrain], STEPS[options]
    lod = rtin.LevelOfDetail(grid)
    rng = np.random.default_rng(12)
    n_events = 0
    for _ in range(12):
        ends = rng.uniform((-5.0, -40.0, 40.0), (40.0, 5.0, 120.0), (2, 3))
        ends[1] = ends[0] + 0.1 * (ends[1] - ends[0])
        before, after = ends
        one, other = (lod.frame(eye, **options) for eye in ends)
        while np.abs(after - before).max() > 1e-9:
            middle = (before + after) / 2.0
            frame = lod.frame(middle, **options)
            if frame.mesh.triangles.tobytes() == one.mesh.triangles.tobytes():
                before, one = middle, frame
            else:
                after, other = middle, frame
        n_events += one.mesh.triangles.tobytes() != other.mesh.triangles.tobytes()
        assert pixels_between(one, other, grid, View(tuple(before))) < 1e-5
    assert n_events > 3


@pytest.mark.parametrize("options", STEPS)
def test_surfaces_change_as_little_as_the_eye_moves(options):
    grid = FILLED["rolling"]
    lod = rtin.LevelOfDetail(grid)
    start, step = np.array([2.0, -30.0, 45.0]), np.array([0.02, 0.007, -0.006])
    frames = [lod.frame(start + k * step, **STEPS[options]) for k in range(200)]
    n_changed = 0
    for k, (one, other) in enumerate(pairwise(frames)):
        view = View(tuple(start + k * step))
        near = np.linalg.norm(samples_of(grid) - view.eye, axis=-1).min()
        moved = np.linalg.norm(step) / near
        assert pixels_between(one, other, grid, view) < 40.0 * moved * one.pixel_error
        n_changed += not same_bytes(one.mesh, other.mesh)
    assert n_changed > 1


# --- terrain that changes -----------------------------------------------------------------------


def hierarchy_of(lod):
    return [lod._own.tobytes(), lod._wholes.tobytes(), lod._bounds.tobytes()]


def meshes_of(lod, eye=(4.0, -3.0, 60.0)):
    """Some of each kind; a lossless one shows that there is a triangle at all."""
    if not naive.finest(lod.grid.heights):
        return []
    frame = lod.frame(eye, pixel_error=40.0)
    return [lod.mesh(max_error=0.0), lod.mesh(max_error=3.0), frame.mesh, frame.morphed]


def assert_equals_starting_afresh(lod, heights, transform):
    afresh = rtin.LevelOfDetail(rtin.Grid(heights, transform))
    np.testing.assert_array_equal(lod.grid.heights, heights)
    assert hierarchy_of(lod) == hierarchy_of(afresh)
    for mesh, other in zip(meshes_of(lod), meshes_of(afresh), strict=True):
        assert same_bytes(mesh, other)


@st.composite
def patches(draw, shape):
    """Slices of any size, at the borders too, and what comes there: voids, heights, or both."""
    spans = []
    for n in shape:
        ends = draw(st.tuples(st.integers(0, n), st.integers(0, n)) | st.just((0, n)))
        spans.append(slice(min(ends), max(min(ends) + 1, max(ends))))
        if spans[-1].start == n:
            spans[-1] = slice(n - 1, n)
    size = tuple(span.stop - span.start for span in spans)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = np.round(16 * rng.normal(0.0, draw(st.sampled_from([0.0, 2.0, 50.0])), size)) / 16
    values[rng.random(size) < draw(st.sampled_from([0.0, 0.0, 0.3, 1.0]))] = np.nan
    return *spans, values


@settings(max_examples=80)
@given(grids(), st.data())
def test_updates_equal_starting_afresh(grid, data):
    lod = rtin.LevelOfDetail(grid)
    expected = grid.heights.copy()
    for _ in range(data.draw(st.integers(1, 4))):
        rows, cols, values = data.draw(patches(grid.shape))
        expected[rows, cols] = values
        if np.isnan(expected).all():
            with pytest.raises(ValueError, match="no value at all"):
                lod.update(rows, cols, values)
            return
        lod.update(rows, cols, values)
        assert_equals_starting_afresh(lod, expected, grid.transform)


@pytest.mark.parametrize("holes", ["none", "pond", "scattered"])
@pytest.mark.parametrize("shape", [(129, 129), (140, 90)], ids=str)
def test_updates_of_larger_terrain_equal_starting_afresh(shape, holes):
    heights = terrains.waves(shape) + terrains.noise(shape) / 64
    heights = terrains.pierced(heights, terrains.HOLES[holes](shape)).astype(np.float32)
    lod = rtin.LevelOfDetail(rtin.Grid(heights))
    rng = np.random.default_rng(shape[1])
    for n in (1, 2, 5, 17, 64, 1, 30, 3):
        row, col = rng.integers(0, np.subtract(shape, n) + 1)
        patch = np.s_[row : row + n], np.s_[col : col + n]
        change = rng.choice([np.nan, 30.0, 0.01]) * rng.normal(size=(n, n))
        heights = heights.copy()
        heights[patch] = np.where(np.isnan(heights[patch]), 7.0, heights[patch] + change)
        lod.update(*patch, heights[patch])
        afresh = rtin.LevelOfDetail(rtin.Grid(heights))
        assert hierarchy_of(lod) == hierarchy_of(afresh)
    assert same_bytes(lod.mesh(max_error=9.0), afresh.mesh(max_error=9.0))


def test_what_is_undone_leaves_nothing_behind():
    grid = rolling((40, 33), holes="scattered")
    lod = rtin.LevelOfDetail(grid)
    before = hierarchy_of(lod)
    rows, cols = slice(3, 30), slice(10, 33)
    lod.update(rows, cols, np.full((27, 23), 1e5))
    assert hierarchy_of(lod) != before
    lod.update(rows, cols, grid.heights[rows, cols])
    assert hierarchy_of(lod) == before


def test_an_update_leaves_the_callers_arrays_and_earlier_grids_alone():
    heights = np.float32(terrains.waves((9, 9)))
    grid = rtin.Grid(heights)
    lod = rtin.LevelOfDetail(grid)
    assert lod.grid is grid
    lod.update(slice(2, 4), slice(0, 3), np.full((2, 3), 5.0))
    second = lod.grid
    lod.update(slice(0, 1), slice(0, 1), [[-7]])
    np.testing.assert_array_equal(heights, terrains.waves((9, 9)))
    np.testing.assert_array_equal(grid.heights, terrains.waves((9, 9)))
    assert second.heights[[0, 2], [0, 2]].tolist() == [0.0, 5.0]
    assert lod.grid.heights[[0, 2], [0, 2]].tolist() == [-7.0, 5.0]


def sent_without_a_copy(lod):
    """Unpickled over memory that may only be read, as of another process."""
    buffers = []
    data = pickle.dumps(lod, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(data, buffers=[bytes(buffer) for buffer in buffers])


@pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, lambda lod: pickle.loads(pickle.dumps(lod)), sent_without_a_copy],
    ids=["copy", "deepcopy", "pickle", "buffers"],
)
@pytest.mark.parametrize("is_changed_before", [False, True])
def test_a_copy_is_updated_alone(copied, is_changed_before):
    heights = terrains.noise((9, 12)).astype(np.float64) + 1e-9
    lod = rtin.LevelOfDetail(rtin.Grid(heights))
    if is_changed_before:
        lod.update(slice(0, 2), slice(0, 2), np.full((2, 2), 7.0))
    before = lod.grid.heights.copy()
    other = copied(lod)
    other.update(slice(4, 6), slice(4, 6), np.full((2, 2), 50.0))
    after = before.copy()
    after[4:6, 4:6] = 50.0
    assert_equals_starting_afresh(other, after, lod.grid.transform)
    assert_equals_starting_afresh(lod, before, lod.grid.transform)
    assert not any(one._heights.flags.writeable for one in (lod, other))


def test_an_update_takes_slices_as_python_does():
    heights = np.float32(terrains.waves((9, 12)))
    for rows, cols in [
        (slice(None), slice(-3, None)),
        (slice(-1, 99), slice(4)),
        (slice(0, 1), slice(0, 1, 1)),
    ]:
        lod = rtin.LevelOfDetail(rtin.Grid(heights))
        expected = heights.copy()
        expected[rows, cols] = 3.25
        lod.update(rows, cols, expected[rows, cols])
        assert_equals_starting_afresh(lod, expected, rtin.Grid(heights).transform)


def test_an_update_takes_masked_and_whole_numbers():
    lod = rtin.LevelOfDetail(rtin.Grid(np.zeros((9, 9))))
    lod.update(slice(0, 1), slice(0, 3), np.ma.array([[1, 2, 3]], mask=[[0, 1, 0]]))
    np.testing.assert_array_equal(lod.grid.heights[0, :4], [1.0, np.nan, 3.0, 0.0])
    assert lod.grid.has_voids


# --- threads ------------------------------------------------------------------------------------


def everything(grid):
    lod = rtin.LevelOfDetail(grid)
    eye = (*(grid.transform @ (40.0, 40.0)), 90.0)
    yield from hierarchy_of(lod)
    lod.update(slice(20, 300), slice(1, 60), np.ones((280, 59)))
    yield from hierarchy_of(lod)
    for mesh in (lod.mesh(max_error=2.0), lod.mesh(eye), lod.frame(eye, max_triangles=999).morphed):
        yield mesh.vertices.tobytes() + mesh.triangles.tobytes()


@pytest.mark.parametrize("holes", ["none", "pond"])
def test_number_of_threads_and_bands_changes_no_byte(monkeypatch, holes):
    from rtin import _parallel

    grid = rolling((530, 70), holes=holes)
    results = []
    for n_threads, fewest_rows in (("1", 256), ("2", 256), ("5", 256), ("2", 3), ("1", 10**6)):
        monkeypatch.setenv("RTIN_NUM_THREADS", n_threads)
        monkeypatch.setattr(_parallel, "_FEWEST_ROWS", fewest_rows)
        results.append(list(everything(grid)))
    assert all(result == results[0] for result in results)


def test_several_threads_may_ask_at_once():
    lod = rtin.LevelOfDetail(rolling())
    eyes = [(x, -x, 40.0) for x in range(0, 64, 4)]
    alone = [lod.mesh(eye, max_triangles=500) for eye in eyes]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda eye: lod.mesh(eye, max_triangles=500), eyes))
    assert all(same_bytes(one, other) for one, other in zip(alone, together, strict=True))


def test_the_hierarchy_is_at_most_twice_the_raster():
    heights = np.zeros((1025, 1025), np.float32)
    assert rtin.LevelOfDetail(rtin.Grid(heights)).nbytes < 2.0 * heights.nbytes


# --- bad input ----------------------------------------------------------------------------------

EYE = (1.0, -1.0, 9.0)


@pytest.fixture(scope="module")
def small():
    return rtin.LevelOfDetail(rtin.Grid(terrains.noise((9, 12))))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "exactly one of max_error, max_triangles; got none"),
        ({"pixel_error": 1.0}, "need an eye"),
        ({"frustum": np.zeros((5, 4)), "max_error": 1.0}, "need an eye"),
        ({"max_error": 1.0, "max_triangles": 100}, "exactly one of"),
        ({"max_error": -1.0}, "max_error must be zero or more"),
        ({"max_error": math.nan}, "max_error must be zero or more"),
        ({"max_triangles": 1}, "max_triangles must be at least 2"),
        ({"max_triangles": -5}, "max_triangles must be at least 2"),
        ({"max_triangles": 20}, "max_triangles must be at least .* for this outline, got 20"),
        ({"eye": EYE, "max_error": 1.0}, "max_error goes without an eye"),
        ({"eye": EYE, "pixel_error": 1.0, "max_triangles": 9}, "exactly one of"),
        ({"eye": EYE, "pixel_error": -1.0}, "pixel_error must be zero or more, in pixels"),
        ({"eye": EYE, "pixel_error": math.nan}, "pixel_error must be zero or more"),
        ({"eye": EYE, "max_triangles": 1}, "max_triangles must be at least 2"),
        ({"eye": EYE[:2]}, "eye must be three finite numbers"),
        ({"eye": [EYE]}, "eye must be three finite numbers"),
        ({"eye": (1.0, math.nan, 2.0)}, "eye must be three finite numbers"),
        ({"eye": (1.0, math.inf, 2.0)}, "eye must be three finite numbers"),
        ({"eye": "here"}, "eye must be three finite numbers"),
        ({"eye": (1.0, (2.0, 3.0), 4.0)}, "eye must be three finite numbers"),
        ({"max_error": 10**400}, "max_error must fit a float64"),
        ({"eye": EYE, "field_of_view": 0.0}, "field_of_view must be between 0 and 180"),
        ({"eye": EYE, "field_of_view": 180.0}, "field_of_view must be between 0 and 180"),
        ({"eye": EYE, "field_of_view": math.nan}, "field_of_view must be between 0 and 180"),
        ({"eye": EYE, "field_of_view": 5e-324}, "field_of_view must be between 0 and 180"),
        ({"eye": EYE, "height": 5e-324}, "height must be pixels of a picture of 60.0 degrees"),
        ({"eye": EYE, "height": 1e308, "field_of_view": 1.0}, "height must be pixels"),
        ({"eye": EYE, "frustum": [[1, 2, 3, 4], [5, 6]]}, r"shape \(n, 4\), got shape \(2,\)"),
        ({"eye": EYE, "height": 0}, "height must be a positive number of pixels, got 0"),
        ({"eye": EYE, "height": -3}, "height must be a positive number of pixels"),
        ({"eye": EYE, "height": math.inf}, "height must be a positive number of pixels"),
        ({"eye": EYE, "exaggeration": 0.0}, "exaggeration must be from 1e-06 to 1e.06, got 0"),
        ({"eye": EYE, "exaggeration": 1e300}, "exaggeration must be from 1e-06 to 1e.06"),
        ({"eye": EYE, "exaggeration": math.nan}, "exaggeration must be from 1e-06 to 1e.06"),
        ({"eye": EYE, "frustum": np.zeros(4)}, r"shape \(n, 4\), got shape \(4,\)"),
        ({"eye": EYE, "frustum": np.zeros((5, 3))}, r"shape \(n, 4\), got shape \(5, 3\)"),
        ({"eye": EYE, "frustum": np.full((1, 4), math.nan)}, "frustum must hold finite numbers"),
    ],
)
def test_refuses_wrong_options(small, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        small.mesh(**options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options",
    [
        {"max_error": "much"},
        {"max_error": [1.0]},
        {"max_triangles": 30.5},
        {"max_triangles": "many"},
        {"eye": EYE, "pixel_error": "one"},
        {"eye": EYE, "height": None},
        {"eye": EYE, "field_of_view": "wide"},
    ],
)
def test_refuses_what_is_no_number(small, options):
    with pytest.raises(TypeError, match=f"{list(options)[-1]} must be") as caught:
        small.mesh(**options)
    assert "\n" not in str(caught.value)


def test_refuses_a_frame_without_an_eye(small):
    with pytest.raises(ValueError, match="needs an eye"):
        small.frame(None, pixel_error=1.0)
    with pytest.raises(ValueError, match="exactly one of"):
        small.frame(EYE, pixel_error=1.0, max_triangles=100)


def test_takes_a_grid_only():
    with pytest.raises(TypeError, match="a Grid is wanted, got ndarray"):
        rtin.LevelOfDetail(np.zeros((9, 9)))


def test_refuses_an_eye_over_degrees():
    grid = rtin.Grid(terrains.noise((9, 9)), (1e-3, 0, 7.0, 0, -1e-3, 46.0), "EPSG:4326")
    lod = rtin.LevelOfDetail(grid)
    assert lod.mesh(max_error=30.0).crs == grid.crs
    for make in (lod.mesh, lod.frame):
        with pytest.raises(ValueError, match=r"grid is in degrees.*in_metres\(\)"):
            make(EYE)
    assert rtin.LevelOfDetail(grid.in_metres()).mesh((0.0, 0.0, 500.0)).n_triangles > 0


def test_a_grid_without_a_triangle_has_no_mesh():
    heights = np.full((5, 5), np.nan)
    heights[::2, ::2] = 1.0
    lod = rtin.LevelOfDetail(rtin.Grid(heights))
    for options in ({"max_error": 1.0}, {"max_triangles": 9}):
        with pytest.raises(ValueError, match="no triangle"):
            lod.mesh(**options)
    assert lod.mesh(EYE).n_triangles == 0


def test_what_is_out_of_sight_has_no_triangle():
    heights = np.full((9, 9), np.nan)
    heights[:3, :3] = 1.0
    view = View(EYE, frustum=rtin.frustum(EYE, (1.0, -1.0, 99.0), up=(0, 1, 0)))
    frame = rtin.LevelOfDetail(rtin.Grid(heights)).frame(**view.options)
    assert frame.mesh.n_triangles == frame.morphed.n_triangles == len(frame.weights) == 0


ROWS, COLS = slice(2, 4), slice(1, 4)


@pytest.mark.parametrize(
    ("rows", "cols", "heights", "error", "message"),
    [
        (2, COLS, np.zeros((1, 3)), TypeError, "rows must be a slice, got 2"),
        (ROWS, [1, 2], np.zeros((2, 2)), TypeError, "cols must be a slice"),
        (ROWS, slice(0, 1.5), np.zeros((2, 1)), TypeError, "cols must be a slice of whole numbers"),
        (ROWS, slice("a", "b"), np.zeros((2, 1)), TypeError, "slice of whole numbers"),
        (slice(0, 4, 2), COLS, np.zeros((2, 3)), ValueError, "without a step"),
        (slice(4, 2, -1), COLS, np.zeros((2, 3)), ValueError, "without a step"),
        (ROWS, slice(0, 4, 0), np.zeros((2, 3)), ValueError, "step"),
        (slice(4, 4), COLS, np.zeros((0, 3)), ValueError, "rows must be some of 0 to 9"),
        (slice(20, 30), COLS, np.zeros((10, 3)), ValueError, "rows must be some of 0 to 9"),
        (ROWS, slice(10, 14), np.zeros((2, 4)), ValueError, r"patch's shape \(2, 2\)"),
        (ROWS, COLS, np.zeros((3, 2)), ValueError, r"patch's shape \(2, 3\)"),
        (ROWS, COLS, 5.0, ValueError, r"patch's shape \(2, 3\)"),
        (ROWS, COLS, np.zeros((2, 3, 1)), ValueError, r"patch's shape \(2, 3\)"),
        (ROWS, COLS, np.full((2, 3), math.inf), ValueError, "at most 1e\\+100"),
        (ROWS, COLS, np.full((2, 3), -2e100), ValueError, "at most 1e\\+100"),
        (ROWS, COLS, np.full((2, 3), "high"), TypeError, "must be real numbers"),
        (ROWS, COLS, np.full((2, 3), 1j), TypeError, "must be real numbers"),
        (slice(None), slice(None), np.full((9, 12), math.nan), ValueError, "no value at all"),
    ],
)
def test_refuses_wrong_updates_and_changes_nothing(rows, cols, heights, error, message):
    lod = rtin.LevelOfDetail(rtin.Grid(terrains.noise((9, 12))))
    before = hierarchy_of(lod)
    with pytest.raises(error, match=message) as caught:
        lod.update(rows, cols, heights)
    assert "\n" not in str(caught.value)
    assert hierarchy_of(lod) == before
    np.testing.assert_array_equal(lod.grid.heights, terrains.noise((9, 12)))


def test_heights_beyond_float32_do_not_fit_such_a_grid():
    lod = rtin.LevelOfDetail(rtin.Grid(terrains.noise((9, 12))))
    with pytest.raises(ValueError, match="float32"):
        lod.update(ROWS, COLS, np.full((2, 3), 1e60))


# --- extreme heights ----------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-44, 1e-30, 1e-5, 1e12, 1e37, 1e60, 1e98])
def test_keeps_its_promise_at_every_magnitude(scale):
    grid = rtin.Grid(terrains.noise((17, 13)) * scale)
    lod = rtin.LevelOfDetail(grid)
    for tolerance in (0.0, 5.0 * scale, 40.0 * scale):
        mesh = lod.mesh(max_error=tolerance)
        validity.check(mesh)
        assert rtin.vertical_error(mesh, grid).max <= tolerance * (1 + 1e-6) + 1e-13 * scale
    if scale < 1e37:
        assert mesh.n_triangles < lod.mesh(max_error=0.0).n_triangles
    eye = (5.0, -5.0, 90.0 * scale)
    assert_keeps_its_promise(lod.mesh(eye, pixel_error=30.0), grid, View(eye), 30.0)


# --- the frustum of a picture -------------------------------------------------------------------


def camera(eye, target, up):
    forward = np.subtract(target, eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return forward, right, np.cross(right, forward)


numbers = st.floats(-10.0, 10.0)


def test_only_directions_count_for_a_frustum():
    one = rtin.frustum((1.0, 2.0, 3.0), (4.0, 5.0, 3.0), up=(0.1, 0.0, 1.0))
    for far, length in ((1e-13, 1.0), (1.0, 1e-13), (1.0, 1e200), (1e200, 1.0)):
        other = rtin.frustum((0.0, 0.0, 0.0), (far, far, 0.0), up=(0.1 * length, 0.0, length))
        np.testing.assert_allclose(other[:, :3], one[:, :3], atol=1e-15)


@given(
    st.tuples(numbers, numbers, numbers),
    st.tuples(numbers, numbers, numbers),
    st.sampled_from([(0.0, 0.0, 1.0), (0.0, 1.0, 0.5), (3.0, -1.0, 0.2)]),
    st.floats(5.0, 150.0),
    st.floats(0.2, 4.0),
    st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-5.0, 50.0)),
)
def test_a_frustum_holds_what_the_picture_shows(eye, target, up, angle, aspect, point):
    assume(np.linalg.norm(np.cross(np.subtract(target, eye), up)) > 0.1)
    planes = rtin.frustum(eye, target, field_of_view=angle, aspect=aspect, up=up)
    assert planes.shape == (5, 4)
    assert planes.dtype == np.float64
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
    across, above, ahead = point  # in half widths and half heights of the picture
    assume(abs(abs(across) - 1) > 1e-6 and abs(abs(above) - 1) > 1e-6 and abs(ahead) > 1e-3)
    forward, right, top = camera(eye, target, up)
    tangent = math.tan(math.radians(angle) / 2.0)
    place = eye + ahead * (forward + tangent * (aspect * across * right + above * top))
    is_inside = (planes[:, :3] @ place + planes[:, 3] >= 0.0).all()
    assert is_inside == (abs(across) < 1.0 and abs(above) < 1.0 and ahead > 0.0)


def test_planes_come_left_right_bottom_top_and_near():
    planes = rtin.frustum((0.0, 0.0, 0.0), (0.0, 5.0, 0.0), field_of_view=90.0, aspect=2.0)
    on_each = [(-2.0, 1.0, 0.0), (2.0, 1.0, 0.0), (0.0, 1.0, -1.0), (0.0, 1.0, 1.0), (3, 0, 4)]
    for plane, point in zip(planes, on_each, strict=True):
        assert plane[:3] @ point + plane[3] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_array_equal(planes[:, :3] @ (0.0, 1.0, 0.0) + planes[:, 3] > 0.0, True)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"target": (1.0, 2.0, 3.0)}, ValueError, "eye and target must be two points"),
        ({"target": (1.0, 2.0, 99.0)}, ValueError, "up must not run along the line"),
        ({"up": (0.0, 0.0, 0.0)}, ValueError, "up must not"),
        ({"up": (0.0, 1.0)}, ValueError, "up must be three finite numbers"),
        ({"eye": (math.nan, 0.0, 0.0)}, ValueError, "eye must be three finite numbers"),
        ({"target": (math.inf, 0.0, 0.0)}, ValueError, "target must be three finite numbers"),
        ({"aspect": 0.0}, ValueError, "aspect must be positive"),
        ({"aspect": math.inf}, ValueError, "aspect must be positive"),
        ({"aspect": "wide"}, TypeError, "aspect must be"),
        ({"field_of_view": -10.0}, ValueError, "field_of_view must be between 0 and 180"),
    ],
)
def test_a_frustum_needs_a_picture(options, error, message):
    given = {"eye": (1.0, 2.0, 3.0), "target": (4.0, 5.0, 3.0), **options}
    with pytest.raises(error, match=message):
        rtin.frustum(given.pop("eye"), given.pop("target"), **given)


# --- metres -------------------------------------------------------------------------------------


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:4267", "EPSG:4807"])  # the last in grads
@pytest.mark.parametrize("latitude", [-33.0, 0.0, 47.0, 80.0])
def test_in_metres_is_as_long_as_on_the_ellipsoid(crs, latitude):
    import pyproj

    turned = Affine.translation(8.0, latitude) @ Affine.rotation(20.0) @ Affine.scale(1e-4, -2e-4)
    grid = rtin.Grid(terrains.noise((5, 9)), turned, crs)
    metres = grid.in_metres()
    assert metres.crs is None
    np.testing.assert_array_equal(metres.heights, grid.heights)
    np.testing.assert_allclose(metres.transform @ (4.0, 2.0), 0.0, atol=1e-6)
    to_degrees = 0.9 if crs == "EPSG:4807" else 1.0
    middle, end = (np.multiply(turned @ place, to_degrees) for place in ((4.0, 2.0), (8.0, 0.0)))
    azimuth, _, length = pyproj.CRS(crs).get_geod().inv(*middle, *end)
    east, north = metres.transform @ (8.0, 0.0)
    assert np.hypot(east, north) == pytest.approx(length, rel=1e-4)
    assert np.degrees(np.arctan2(east, north)) == pytest.approx(azimuth, abs=0.01)


def test_in_metres_leaves_other_grids_alone():
    for crs in (None, "EPSG:2056", "EPSG:32632"):
        grid = rolling((9, 9), crs=crs)
        assert grid.in_metres() is grid
