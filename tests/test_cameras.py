"""Where terrain is looked at from."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rtin
from rtin.viewer import cameras
from rtin.viewer.pictures import as_terrain
from rtin.viewer.scene import SIDE, Place, Settings, Terrain, View


def rough(shape=(40, 65), seed=3, step=25.0, roughness=200.0):
    heights = np.random.default_rng(seed).normal(scale=roughness, size=shape)
    return rtin.Grid(heights, (step, 0.0, 5e5, 0.0, -step, 4e6))


def above(grid, place, views, exaggeration=1.0):
    """How much higher than the ground below the eyes of views are, in the scene."""
    eyes = np.array([view.eye for view in views])
    world = place.into_world(eyes, exaggeration)
    ground = np.column_stack([world[:, :2], grid.heights_at(world[:, :2])])
    return eyes[:, 2] - place.into_scene(ground, exaggeration)[:, 2]


def on_screen(view, points):
    """Where points are on a screen of 16 : 9; inside it between -1 and 1."""
    forward = np.subtract(view.target, view.eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, view.up)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, forward), forward])
    x, y, depth = axes @ (points - np.array(view.eye)).T
    assert (depth > 0.0).all()
    half = np.tan(np.radians(view.field_of_view) / 2.0)
    return np.column_stack([x / (half * view.aspect), y / half]) / depth[:, np.newaxis]


def corners_of(terrain, exaggeration):
    corners = np.array(np.meshgrid(*terrain.bounds.T)).reshape(3, -1).T
    return terrain.place.into_scene(corners, exaggeration)


@pytest.mark.parametrize(
    ("eye", "target", "message"),
    [((0, 0, np.nan), (1, 1, 1), "eye must be three finite numbers"),
     ((0, 0, 1), (1, 1), "target must be three finite numbers"),
     ((1, 2, 3), (1.0, 2.0, 3.0), "eye and target must be two points")],
)  # fmt: skip
def test_a_view_needs_two_points(eye, target, message):
    with pytest.raises(ValueError, match=message):
        cameras.seen_from(Terrain(rough()).place, eye, target)


@pytest.mark.parametrize("exaggeration", [0.2, 5.0])
@given(st.floats(0.0, 360.0), st.floats(-80.0, 80.0))
def test_what_is_not_in_sight_is_nowhere_on_the_screen(exaggeration, turn, down):
    terrain = Terrain(rough())
    turn, down = np.radians(turn), np.radians(down)
    eye = np.array([0.0, -120.0, 30.0])
    ahead = np.array([np.sin(turn), np.cos(turn), -np.sin(down)])
    view = View(tuple(eye), tuple(eye + 10.0 * ahead))
    samples = terrain.place.into_scene(corners_of_cells(rough()), exaggeration)
    planes = rtin.frustum(view.eye, view.target, aspect=view.aspect)
    is_seen = (samples @ planes[:, :3].T + planes[:, 3] >= 0.0).all(axis=1).any()
    assert cameras.is_in_sight(terrain, view, exaggeration) >= is_seen


def test_what_is_behind_and_beside_is_out_of_sight():
    terrain = Terrain(rough())
    eye = (0.0, -120.0, 30.0)
    for target, is_in_sight in (
        ((0.0, 0.0, 0.0), True), ((0.0, -220.0, 30.0), False), ((100.0, -121.0, 30.0), False),
        ((0.0, -110.0, 90.0), False),
    ):  # fmt: skip
        assert cameras.is_in_sight(terrain, View(eye, target)) == is_in_sight


def corners_of_cells(grid):
    row, col = np.indices(grid.shape)
    a, _, x, _, e, y = tuple(grid.transform)[:6]
    return np.column_stack([(x + a * col).ravel(), (y + e * row).ravel(), grid.heights.ravel()])


@pytest.mark.parametrize("exaggeration", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("aspect", [0.5, 16 / 9])
@pytest.mark.parametrize("shape", [(40, 65), (65, 65), (65, 6), (6, 65)])
def test_a_first_view_is_filled_by_the_whole_terrain(shape, aspect, exaggeration):
    terrain = Terrain(rough(shape))
    view = replace(cameras.overlook(terrain, exaggeration, aspect), aspect=aspect)
    seen = on_screen(view, corners_of(terrain, exaggeration))
    assert np.abs(seen).max() == pytest.approx(0.9)
    assert seen[:, 1].max() == pytest.approx(-seen[:, 1].min())


@pytest.mark.parametrize("shape", [(40, 65), (65, 6)])
def test_all_of_an_orbit_sees_the_whole_terrain(shape):
    terrain = Terrain(rough(shape))
    for view in cameras.orbit(9, terrain, 2.0):
        assert np.abs(on_screen(view, corners_of(terrain, 2.0))).max() < 0.95


@given(st.integers(1, 40))
def test_an_orbit_goes_round_once_in_equal_steps(n):
    eyes = np.array([view.eye for view in cameras.orbit(n)])
    x, y, z = eyes.T
    assert np.allclose(z, z[0])
    turns = (np.arctan2(y, x) - np.arctan2(y[0], x[0])) / (2.0 * np.pi)
    assert np.allclose((turns + 1e-9) % 1.0, np.arange(n) / n, atol=1e-6)


@given(st.integers(1, 300), st.integers(0, 5), st.sampled_from([0.5, 1.0, 4.0]))
def test_a_flight_stays_above_the_ground(n, seed, exaggeration):
    grid = rough(seed=seed, roughness=20.0)
    place = Place.of(grid.bounds)
    views = cameras.flight(grid, place, n, exaggeration)
    assert len(views) == n
    # No point of the path is further than this from the nearest of the 2000 places.
    half_a_step = 0.34 * SIDE * 2.0 * np.pi * np.sqrt(2.0) / 2000 / 2.0
    steepest = np.hypot(*(np.abs(np.diff(grid.heights, axis=axis)).max() / 25.0 for axis in (0, 1)))
    least = 0.035 * SIDE - half_a_step * steepest * exaggeration
    assert above(grid, place, views, exaggeration).min() > least > 0.0


def test_a_flight_follows_the_ground():
    row, _ = np.indices((200, 200))
    step = rtin.Grid(np.where(row < 100, 800.0, 0.0), (25.0, 0.0, 0.0, 0.0, -25.0, 0.0))
    place = Place.of(step.bounds)
    heights = np.array([view.eye[2] for view in cameras.flight(step, place, 200)])
    assert heights.max() - heights.min() == pytest.approx(800.0 * place.scale, rel=1e-6)


def test_a_flight_has_no_jumps_and_ends_where_it_began():
    grid = rough()
    views = cameras.flight(grid, Place.of(grid.bounds), 400)
    eyes = np.array([view.eye for view in views])
    steps = np.linalg.norm(np.diff(eyes, axis=0, append=eyes[:1]), axis=1)
    assert steps.max() < 0.03 * SIDE
    assert steps.min() > 0.0


def test_a_flight_looks_ahead_along_its_path_at_the_ground():
    level = rtin.Grid(np.full((30, 30), 700.0), (25.0, 0.0, 0.0, 0.0, -25.0, 0.0))
    views = cameras.flight(level, Place.of(level.bounds), 500)
    eyes, targets = (
        np.array([getattr(view, name) for view in views]) for name in ("eye", "target")
    )
    ahead = np.roll(eyes, -30, axis=0)  # 0.06 of the path
    assert np.allclose(targets[:, :2], ahead[:, :2])
    assert np.allclose(targets[:, 2], 0.0)
    assert np.allclose(eyes[:, 2], 0.035 * SIDE)


def test_a_flight_over_a_mesh_follows_its_ground():
    grid = rough()
    mesh = rtin.coarsen(grid, max_error=0.0)
    place = Place.of(grid.bounds)
    over_grid = np.array([view.eye for view in cameras.flight(grid, place, 60)])
    over_mesh = np.array([view.eye for view in cameras.flight(mesh, place, 60)])
    assert np.allclose(over_mesh[:, :2], over_grid[:, :2])
    # Both know the same samples; between them one has triangles, the other one curved cells.
    assert np.abs(over_mesh - over_grid)[:, 2].max() < 0.4 * np.ptp(over_grid[:, 2])
    highest = place.into_scene(mesh.bounds)[1, 2] + 0.035 * SIDE
    assert over_mesh[:, 2].min() < highest - 0.5


def test_a_flight_over_voids_stays_above_the_lowest_ground():
    heights = np.full((30, 30), 700.0)
    heights[:, :20] = np.nan
    heights[0, 25] = 100.0
    grid = rtin.Grid(heights, (25.0, 0.0, 0.0, 0.0, -25.0, 0.0))
    place = Place.of(grid.bounds)
    eyes = np.array([view.eye for view in cameras.flight(grid, place, 100)])
    assert np.isfinite(eyes).all()
    lowest = place.into_scene([[0.0, 0.0, 100.0]])[0, 2]
    assert eyes[:, 2].min() >= lowest + 0.035 * SIDE - 1e-9


def test_views_of_the_world_are_put_into_the_scene():
    grid = rough()
    place = Place.of(grid.bounds)
    eye, target = np.array([5.01e5, 3.9e6, 900.0]), place.middle
    view = cameras.seen_from(place, eye, target, exaggeration=2.0)
    assert np.allclose(place.into_world(view.eye, 2.0), eye)
    assert np.allclose(view.target, 0.0)


@pytest.mark.parametrize("above", [1.0, -1.0])
def test_north_is_up_in_a_view_straight_down_or_up(above):
    terrain = as_terrain(rough())
    middle = terrain.place.middle
    view = cameras.seen_from(terrain.place, middle + np.array([0.0, 0.0, above * 5000.0]), middle)
    assert view.up == (0.0, 1.0, 0.0)
    assert terrain.draw(view, Settings()).n_triangles > 0


@pytest.mark.parametrize("n", [0, -3])
def test_no_view_is_no_path(n):
    with pytest.raises(ValueError, match="n must be"):
        cameras.orbit(n)
    with pytest.raises(ValueError, match="n must be"):
        cameras.flight(rough(), Place.of(rough().bounds), n)


@pytest.mark.parametrize("n", [2.5, "many", True])
def test_a_number_of_views_is_a_whole_number(n):
    with pytest.raises(TypeError, match="n must be"):
        cameras.orbit(n)


def test_a_mesh_in_degrees_has_the_place_of_its_grid():
    heights = np.random.default_rng(0).normal(size=(30, 40))
    grid = rtin.Grid(heights, (0.01, 0.0, 8.0, 0.0, -0.01, 47.0), "EPSG:4326")
    mesh = rtin.coarsen(grid, max_error=0.0)
    of_grid, of_mesh = as_terrain(grid).bounds, as_terrain(mesh).bounds
    assert np.allclose(of_grid, of_mesh, atol=0.01)
