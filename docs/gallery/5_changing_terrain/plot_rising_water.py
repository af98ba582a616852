"""
Rising water
============

A lake rises in a valley: its surface is flat, at one level, wherever water can get from the deepest
place. Each new level changes the lake and its shore only, and the lake itself takes a few large
triangles. (What is below water is found with SciPy.)
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation
from scipy.ndimage import binary_dilation, find_objects, label

import rtin
from rtin import samples
from rtin.viewer.pictures import picture
from rtin.viewer.scene import Place, Settings, Terrain, View, usual_painters


def flooded(ground, level, source):
    """Return which samples water reaches from a source when it stands at a level."""
    basins, _ = label(ground < level)
    return (basins == basins[source]) & (ground < level)


def rise(lod, ground, level, source):
    """Fill the lake to a higher level; return which samples are under water."""
    wet = flooded(ground, level, source)
    (patch,) = find_objects(wet.astype(int))
    lod.update(*patch, np.where(wet, level, ground)[patch])
    return wet


def shore(wet):
    """Return the samples on both sides of a shoreline."""
    return binary_dilation(wet, np.ones((3, 3))) & binary_dilation(~wet, np.ones((3, 3)))


# %%

grid = samples.jacksboro_fault().in_metres()
ground = grid.heights
CELL_AREA = abs(grid.transform.a * grid.transform.e) / 1e6  # square kilometres
source = np.unravel_index(ground.argmin(), grid.shape)
lod = rtin.LevelOfDetail(grid)
levels = np.arange(265.0, 390.0, 11.0)
lakes, meshes = [], []
for level in levels:
    lakes.append(rise(lod, ground, level, source))
    meshes.append(lod.mesh(max_error=20.0))


def painter(wet):
    """Return what colours a mesh: its relief, and water."""

    def paint(mesh):
        row, col = np.rint(grid.places(mesh.vertices[:, :2])).astype(int).T
        return np.where(wet[row, col, np.newaxis], [0.36, 0.56, 0.72], relief(mesh))

    return paint


relief = usual_painters(meshes[0], None)["hillshade"]
place = Place.of(grid.bounds)
view = View((62.0, -78.0, 48.0), (12.0, -14.0, -2.0), field_of_view=44.0)
look = Settings(wireframe=True, exaggeration=3.0)
pictures = [
    picture(
        Terrain(mesh, place=place, painters={"water": painter(wet)}),
        view,
        settings=look,
        size=(800, 500),
    )
    for mesh, wet in zip(meshes, lakes, strict=True)
]

fig = plt.figure(figsize=(7.2, 4.5))
ax = fig.add_axes((0, 0, 1, 1))
ax.set_axis_off()
image = ax.imshow(pictures[-1])
caption = ax.text(20, 40, "", fontsize=13)


def show(moment):
    image.set_data(pictures[moment])
    on_lake = lakes[moment].sum() * CELL_AREA
    caption.set_text(f"{levels[moment]:.0f} m: {on_lake:.0f} km² of water")


film = FuncAnimation(fig, show, len(pictures), interval=300)
plt.show()

# %%
# A model of the lake needs its shoreline: ``keep`` holds the samples on both sides of it, and every
# triangle is then land, or water, or one of the smallest between them.

level, wet = levels[6], lakes[6]
surface = rtin.Grid(np.where(wet, level, ground), grid.transform)
mesh = rtin.coarsen(surface, max_error=20.0, keep=shore(wet))
row, col = np.rint(grid.places(mesh.vertices[:, :2])).astype(int).T
n_wet = wet[row, col][mesh.triangles].sum(axis=1)
kind = np.select([n_wet == 0, n_wet == 3], [0, 2], 1)

fig, ax = plt.subplots(figsize=(8, 6.4), layout="constrained")
seen = rtin.to_triangulation(mesh)
ax.tripcolor(seen, facecolors=kind, cmap="BrBG", vmin=-1.2, vmax=3.0)
ax.triplot(seen, color="#33414d", linewidth=0.2)
ax.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
ax.set(xlim=(1500, 15000), ylim=(-15900, -4500), title=f"The lake at {level:.0f} m, and its shore")
plt.show()
