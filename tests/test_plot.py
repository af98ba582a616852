import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.image import imread

import rtin
from hand_meshes import bumpy, in_degrees, in_utm, with_hole
from rtin import plotting, samples
from rtin.grid import Grid
from rtin.mesh import TriangleMesh
from rtin.plotting import plot, require_picture_path, save_picture


def axes():
    return Figure().add_subplot()


def drawn_edges(ax):
    """The segments on the axes, each as a sorted pair of points."""
    (line,) = ax.lines
    points = line.get_xydata()
    segments = points.reshape(-1, 3, 2)[:, :2]
    assert np.isnan(points[2::3]).all()
    return {tuple(sorted(map(tuple, segment))) for segment in segments.tolist()}, len(segments)


def edges_of(mesh):
    return {
        tuple(sorted(tuple(mesh.vertices[v, :2].tolist()) for v in (a, b)))
        for triangle in mesh.triangles
        for a, b in zip(triangle, np.roll(triangle, 1), strict=True)
    }


@pytest.mark.parametrize("shape", [bumpy, with_hole, in_utm])
def test_draws_every_edge_once(shape):
    mesh = shape()
    drawn, n_drawn = drawn_edges(plot(mesh, ax=axes()))
    assert drawn == edges_of(mesh)
    assert n_drawn == len(drawn)


def test_returns_the_axes_it_was_given():
    ax = axes()
    assert plot(bumpy(), ax=ax) is ax


def test_makes_its_own_figure_and_shows_nothing(monkeypatch):
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    monkeypatch.setattr(plt, "show", lambda: pytest.fail("it was shown"))
    ax = plot(bumpy())
    assert ax.figure.number in plt.get_fignums()
    plt.close(ax.figure)


def test_a_degree_of_latitude_is_longer_than_one_of_longitude():
    latitude = np.radians(in_degrees().bounds[:, 1].mean())
    assert plot(in_degrees(), ax=axes()).get_aspect() == pytest.approx(
        1 / np.cos(latitude), rel=5e-3
    )
    assert plot(in_utm(), ax=axes()).get_aspect() == 1.0


def test_axes_have_units():
    ax = plot(in_degrees(), ax=axes())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("longitude (degree)", "latitude (degree)")
    ax = plot(in_utm(), ax=axes())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (metre)", "y (metre)")
    ax = plot(bumpy(), ax=axes())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x", "y")


def test_a_line_width_of_zero_leaves_the_edges_out():
    assert not plot(bumpy(), ax=axes(), line_width=0).lines


def test_big_meshes_have_no_filled_triangles(monkeypatch):
    def n_filled(mesh):
        return len([c for c in plot(mesh, ax=axes()).collections if isinstance(c, PolyCollection)])

    assert n_filled(bumpy()) == 1
    monkeypatch.setattr(plotting, "_MOST_FILLED_TRIANGLES", 10)
    assert n_filled(bumpy()) == 0


def brightness_by_quarter(ax, tmp_path):
    """Mean brightness west, east, north and south of the middle."""
    ax.set_axis_off()
    ax.set_position([0, 0, 1, 1])
    ax.figure.set_size_inches(5, 5)
    ax.figure.savefig(tmp_path / "ridge.png", dpi=40)
    picture = imread(tmp_path / "ridge.png")[20:180, 20:180, :3].mean(axis=2)
    return picture[:, :70].mean(), picture[:, 90:].mean(), picture[:70].mean(), picture[90:].mean()


@pytest.mark.parametrize("from_grid", [True, False])
@pytest.mark.parametrize("row_0_is_north", [True, False])
@pytest.mark.parametrize("ridge_runs", ["north", "east"])
def test_the_light_comes_from_the_north_west(from_grid, row_0_is_north, ridge_runs, tmp_path):
    across = -np.abs(np.arange(21.0) - 10.0)
    heights = np.tile(across, (21, 1)) if ridge_runs == "north" else np.tile(across, (21, 1)).T
    mesh = bumpy(21, 21, heights=heights, step=1.0, north=20.0)
    transform = (1, 0, 0, 0, -1, 20) if row_0_is_north else (1, 0, 0, 0, 1, 0)
    grid = Grid(heights, transform) if from_grid else None
    ax = plot(mesh, grid=grid, ax=axes(), line_width=0)
    west, east, north, south = brightness_by_quarter(ax, tmp_path)
    if ridge_runs == "north":
        assert west > east + 0.1
    else:
        assert north > south + 0.1


@pytest.mark.parametrize("row_0_is_north", [True, False])
def test_the_grid_lies_where_its_transform_says(row_0_is_north):
    rows, cols = 5, 7
    transform = (10, 0, 100, 0, -10, 240) if row_0_is_north else (10, 0, 100, 0, 10, 200)
    mesh = bumpy(rows, cols, step=10.0, west=100.0, north=240.0)
    ax = plot(mesh, grid=Grid(np.eye(rows, cols), transform), ax=axes())
    (image,) = ax.images
    corners = image.get_transform().transform([(0, 0), (cols - 1, rows - 1)])
    first, last = ax.transData.inverted().transform(corners)
    assert first == pytest.approx([100, 240 if row_0_is_north else 200])
    assert last == pytest.approx([160, 200 if row_0_is_north else 240])
    assert ax.get_xlim() == (100.0, 160.0)
    assert ax.get_ylim() == (200.0, 240.0)


def test_void_samples_are_transparent():
    heights = np.eye(9)
    heights[4, 4] = np.nan
    (image,) = plot(bumpy(9, 9), grid=Grid(heights), ax=axes()).images
    alpha = np.asarray(image.get_array())[:, :, 3]
    assert alpha[4, 4] == 0.0
    assert alpha[0, 0] == 255 if alpha.dtype == np.uint8 else 1.0


def test_big_grids_are_thinned_out():
    grid = Grid(np.zeros((10, 4000), dtype=np.float32))
    (image,) = plot(bumpy(), grid=grid, ax=axes()).images
    assert image.get_array().shape[1] <= 1500


def test_flat_meshes_and_thin_ones_can_be_drawn(tmp_path):
    save_picture(bumpy(heights=np.zeros((7, 9))), tmp_path / "flat.png")
    sliver = TriangleMesh([[0, 0, 0], [1000, 0, 0], [0, 1, 0]], [[1, 2, 0]])
    save_picture(sliver, tmp_path / "thin.png")
    assert {path.name for path in tmp_path.iterdir()} == {"flat.png", "thin.png"}


def test_refuses_what_is_no_mesh_or_no_grid(tmp_path):
    grid = Grid(np.zeros((3, 3)))
    with pytest.raises(TypeError, match=r"^a TriangleMesh is wanted, got Grid$"):
        plot(grid)
    with pytest.raises(TypeError, match=r"^a TriangleMesh is wanted, got Grid$"):
        save_picture(grid, tmp_path / "mesh.png")
    with pytest.raises(TypeError, match=r"^a Grid is wanted for the relief, got ndarray$"):
        plot(bumpy(), grid=grid.heights, ax=axes())


def test_refuses_a_mesh_without_triangles():
    with pytest.raises(ValueError, match="without any"):
        plot(TriangleMesh([[0, 0, 0]], np.empty((0, 3), int)), ax=axes())


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_saves_pictures_in_the_format_of_the_extension(suffix, tmp_path):
    starts = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
    save_picture(in_degrees(), tmp_path / f"mesh{suffix}")
    assert (tmp_path / f"mesh{suffix}").read_bytes().startswith(starts[suffix])
    assert len(list(tmp_path.iterdir())) == 1


def test_saving_names_the_extensions_it_knows(tmp_path):
    with pytest.raises(ValueError, match=r"\.pdf.*\.png.*got '\.glb' in"):
        save_picture(bumpy(), tmp_path / "mesh.glb")


def test_what_is_wrong_with_a_path_is_told_before_the_work(tmp_path):
    require_picture_path(tmp_path / "mesh.PNG")
    with pytest.raises(ValueError, match=r"\.pdf.*\.png.*got 'none' in"):
        require_picture_path(tmp_path / "mesh")
    with pytest.raises(FileNotFoundError, match="make it first"):
        require_picture_path(tmp_path / "nowhere" / "mesh.png")
    assert not list(tmp_path.iterdir())


def test_saving_leaves_pyplot_alone(tmp_path):
    from matplotlib import pyplot as plt

    before = plt.get_fignums(), mpl.rcParams["backend"]
    save_picture(bumpy(), tmp_path / "mesh.png")
    assert (plt.get_fignums(), mpl.rcParams["backend"]) == before


def test_saving_to_a_missing_folder_is_told(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"cannot write .*make it first"):
        save_picture(bumpy(), tmp_path / "nowhere" / "mesh.png")


def test_a_picture_says_how_far_the_mesh_is_from_its_raster(tmp_path):
    grid = samples.topobathy()
    mesh = rtin.coarsen(grid, max_error=100.0)
    save_picture(mesh, tmp_path / "mesh.svg", grid=grid)
    drawn = (tmp_path / "mesh.svg").read_text(encoding="utf-8")
    achieved = rtin.vertical_error(mesh, grid).max
    assert f"largest vertical error {achieved:.4g} " in drawn  # the comment over the outlines


def test_a_mesh_beside_its_raster_is_not_drawn(tmp_path):
    grid = samples.topobathy()
    elsewhere = rtin.coarsen(samples.jacksboro_fault(), max_error=100.0)
    with pytest.raises(ValueError, match="covers no sample"):
        save_picture(elsewhere, tmp_path / "mesh.svg", grid=grid)
    assert not (tmp_path / "mesh.svg").exists()
