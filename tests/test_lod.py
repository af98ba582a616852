"""`LevelOfDetail` against its naive twin, what it promises of every view, and starting afresh."""

import math
import warnings
from dataclasses import dataclass, replace

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


def mesh_or_none(lod, **options):
    """A mesh, or None where not even one triangle is seen."""
    try:
        return lod.mesh(**options)
    except ValueError as error:
        assert "triangle" in str(error)
        return None


@settings(max_examples=40)
@given(grids(transforms=("north up",)), st.sampled_from([0.0, 0.5, 2.0, 3.5, 10.0, 40.0]))
def test_keeps_what_the_twin_keeps_for_a_tolerance(grid, tolerance):
    weights = naive.weights_by_height(grid.heights, GROWTH)
    triangles = naive_triangles(grid, [weights], tolerance)
    assume(triangles is not None)
    mesh = rtin.LevelOfDetail(grid).mesh(max_error=tolerance)
    assert naive.triangles_of(mesh, grid) == triangles


@settings(max_examples=80)
@given(scenes(transforms=tuple(terrains.TRANSFORMS)))
def test_keeps_what_the_twin_keeps_for_an_eye(scene):
    grid, view, pixel_error = scene
    planes = np.empty((0, 4)) if view.frustum is None else view.frustum
    weights = [
        naive.weights_by_pixels(grid, GROWTH, view.eye, view.scale, planes, slack)
        for slack in (0.0, SLACK)
    ]
    triangles = naive_triangles(grid, weights, pixel_error)
    assume(triangles is not None)
    mesh = mesh_or_none(rtin.LevelOfDetail(grid), pixel_error=pixel_error, **view.options)
    assert (set() if mesh is None else naive.triangles_of(mesh, grid)) == triangles


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
    lod = rtin.LevelOfDetail(grid)
    mesh = mesh_or_none(lod, pixel_error=pixel_error, **view.options)
    if mesh is not None:
        assert_keeps_its_promise(mesh, grid, view, pixel_error)
        validity.check(mesh)


@settings(max_examples=120)
@given(scenes(), st.data())
def test_frames_keep_the_promise_too_while_they_morph(scene, data):
    grid, view, pixel_error = scene
    pixel_error = data.draw(critical_tolerances(grid, view)) or pixel_error
    try:
        frame = rtin.LevelOfDetail(grid).frame(pixel_error=pixel_error, **view.options)
    except ValueError:
        return
    assert frame.pixel_error == pixel_error
    assert_keeps_its_promise(frame.mesh, grid, view, pixel_error)
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
@given(grids(), terrains.tolerances)
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
    mesh = mesh_or_none(rtin.LevelOfDetail(grid), pixel_error=pixel_error, **view.options)
    covered = np.zeros(grid.shape, bool)
    if mesh is not None:
        covered = ~np.isnan(naive.surface_minus_samples(mesh, grid) + 0.0 * grid.heights)
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
    finer, coarser = (
        vertex_set(lod.mesh(max_error=e), grid) for e in sorted([one, other])
    )
    assert finer >= coarser


@given(scenes())
def test_a_frustum_only_leaves_vertices_out(scene):
    grid, view, pixel_error = scene
    assume(not grid.has_voids and view.frustum is not None)
    lod = rtin.LevelOfDetail(grid)
    all_round = lod.mesh(pixel_error=pixel_error, **replace(view, frustum=None).options)
    within = lod.mesh(pixel_error=pixel_error, **view.options)
    assert vertex_set(within, grid) <= vertex_set(all_round, grid)


@given(scenes(), st.sampled_from([2.0, 3.0, 0.25]))
def test_only_pixels_for_a_length_at_a_distance_count(scene, factor):
    grid, view, pixel_error = scene
    lod = rtin.LevelOfDetail(grid)
    mesh = mesh_or_none(lod, pixel_error=pixel_error, **view.options)
    larger = replace(view, height=view.height * factor)
    other = mesh_or_none(lod, pixel_error=pixel_error * factor, **larger.options)
    assert mesh is other is None or same_bytes(mesh, other)


def rolling(shape=(65, 65), noise=0.3, **options):
    """Hills with all sizes of detail, in float64: no two vertices weigh the same."""
    row, col = np.indices(shape)
    hills = 12.0 * np.sin(row / 11.0) * np.cos(col / 14.0) + 3.0 * np.sin((row + 2 * col) / 5.0)
    fine = np.random.default_rng(3).normal(0.0, noise, shape)
    return rtin.Grid(np.where(terrains.HOLES[options.pop("holes", "none")](shape), np.nan,
                              np.float32(hills + fine)), **options)  # fmt: skip


def test_what_is_far_or_behind_is_coarser():
    grid = rolling()
    lod = rtin.LevelOfDetail(grid)
    eye = (2.0, -32.0, 30.0)  # over the west, looking east
    view = View(eye, frustum=rtin.frustum(eye, (64.0, -32.0, 0.0)))
    mesh = lod.mesh(pixel_error=8.0, **view.options)
    assert mesh.n_vertices < 0.5 * lod.mesh(eye, pixel_error=8.0).n_vertices
    x = lod.mesh(eye, pixel_error=12.0).vertices[:, 0]
    assert (x < 32.0).sum() > 1.5 * (x >= 32.0).sum()


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
            assert rtin.vertical_error(mesh, grid).max == 0.0


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
    for mesh in (lod.mesh(max_error=4.0), frame.mesh, frame.morphed):
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
        if mesh is not frame.morphed:
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


def assert_is_tight(lod, mesh, budget, tolerance, **options):
    """The mesh is that of its tolerance, and just below it there are too many triangles."""
    (name,) = {"pixel_error", "max_error"} - options.keys() if False else (options.pop("name"),)
    assert mesh.n_triangles <= budget
    assert same_bytes(mesh, lod.mesh(**{name: tolerance}, **options))
    if tolerance > 0.0:
        finer = lod.mesh(**{name: np.nextafter(tolerance, 0.0)}, **options)
        assert finer.n_triangles > budget
