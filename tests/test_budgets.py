"""`max_vertices` and `max_triangles` against the family of all least meshes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive
import rtin
import terrains
from rtin import validity


def grid_of(heights):
    return rtin.Grid(np.asarray(heights, dtype=np.float32))


def n_vertices(triangles):
    return len(naive.corners_of(triangles))


SIZE_OF = {"max_vertices": n_vertices, "max_triangles": len}


def assert_is_the_finest_that_fits(grid, name, budget, meshes, keep=None):
    """Compare with the finest mesh of the family, coarsest first, that fits."""
    fitting = [triangles for _, triangles in meshes if SIZE_OF[name](triangles) <= budget]
    if not fitting:
        with pytest.raises(ValueError, match=f"{name} must be at least .*, got {budget}"):
            rtin.coarsen(grid, keep=keep, **{name: budget})
        return
    mesh = rtin.coarsen(grid, keep=keep, **{name: budget})
    assert naive.triangles_of(mesh, grid) == fitting[-1]
    validity.check(mesh)


@given(terrains.rasters(largest=6), st.sampled_from(list(SIZE_OF)), st.data())
def test_is_the_finest_least_mesh_that_fits(heights, name, data):
    grid = grid_of(heights)
    keep = data.draw(st.none() | terrains.masks(grid.shape))
    kept = set() if keep is None else {tuple(p) for p in np.argwhere(keep & ~np.isnan(heights))}
    meshes = naive.family(grid.heights, kept)
    sizes = [SIZE_OF[name](triangles) for _, triangles in meshes]
    for budget in sorted({max(1, size + step) for size in sizes for step in (-1, 0, 1)}):
        assert_is_the_finest_that_fits(grid, name, budget, meshes, keep)


@pytest.mark.parametrize("name", SIZE_OF)
@pytest.mark.parametrize("terrain", terrains.GALLERY)
def test_is_the_finest_least_mesh_of_every_terrain(terrain, name):
    grid = grid_of(terrains.GALLERY[terrain]((9, 9)))
    meshes = naive.family(grid.heights)
    for budget in range(2, 130, 5):
        assert_is_the_finest_that_fits(grid, name, budget, meshes)


@pytest.mark.parametrize("holes", terrains.HOLES)
@pytest.mark.parametrize("terrain", ["waves", "plateaus"])
def test_is_the_finest_least_mesh_around_every_hole(terrain, holes):
    shape = (9, 13)
    heights = terrains.pierced(terrains.GALLERY[terrain](shape), terrains.HOLES[holes](shape))
    grid = grid_of(heights)
    meshes = naive.family(grid.heights)
    for budget in range(20, 130, 20):
        assert_is_the_finest_that_fits(grid, "max_vertices", budget, meshes)


REAL = {
    "jacksboro": rtin.samples.jacksboro_fault,
    "topobathy": rtin.samples.topobathy,
    "complete": lambda: rtin.Grid(rtin.samples.jacksboro_fault().heights[:257, :257]),
    "holes": lambda: rtin.Grid(
        terrains.pierced(
            rtin.samples.topobathy().heights, terrains.pond(rtin.samples.topobathy().shape)
        )
    ),
}


@pytest.mark.parametrize("name", SIZE_OF)
@pytest.mark.parametrize("real", REAL)
def test_achieves_the_smallest_error_within_the_budget_on_real_terrain(real, name):
    grid = REAL[real]()
    outline = rtin.coarsen(grid, max_error=np.inf)
    least = outline.n_vertices if name == "max_vertices" else outline.n_triangles
    for budget in (least, least + 100, least + 1777, 4 * least + 5000):
        mesh = rtin.coarsen(grid, **{name: budget})
        size = mesh.n_vertices if name == "max_vertices" else mesh.n_triangles
        assert size <= budget
        achieved = rtin.vertical_error(mesh, grid).max
        same = rtin.coarsen(grid, max_error=achieved)
        assert same.triangles.tobytes() == mesh.triangles.tobytes()
        if achieved > 0.0:
            finer = rtin.coarsen(grid, max_error=np.nextafter(achieved, 0.0))
            assert budget < (finer.n_vertices if name == "max_vertices" else finer.n_triangles)


def test_a_budget_of_everything_is_lossless():
    grid = grid_of(terrains.noise((9, 12)))
    for options in ({"max_vertices": 10**6}, {"max_triangles": 2**62}, {"max_vertices": 108}):
        mesh = rtin.coarsen(grid, **options)
        assert rtin.vertical_error(mesh, grid).max == 0.0


def test_spends_nothing_on_flat_terrain():
    assert rtin.coarsen(grid_of(np.full((33, 33), 7.0)), max_vertices=1000).n_vertices == 4


def test_takes_any_whole_number():
    grid = grid_of(terrains.waves((9, 9)))
    expected = rtin.coarsen(grid, max_vertices=30)
    mesh = rtin.coarsen(grid, max_vertices=np.uint16(30))
    assert mesh.vertices.tobytes() == expected.vertices.tobytes()


@pytest.mark.parametrize("name", SIZE_OF)
@pytest.mark.parametrize("budget", [-3, 0, 1])
def test_says_what_the_smallest_possible_budget_is(name, budget):
    grid = grid_of(terrains.noise((9, 9)))
    least = {"max_vertices": 4, "max_triangles": 2}[name]
    with pytest.raises(ValueError, match=f"{name} must be at least {least} .* got {budget}"):
        rtin.coarsen(grid, **{name: budget})
    assert rtin.coarsen(grid, **{name: least}).n_triangles == 2
