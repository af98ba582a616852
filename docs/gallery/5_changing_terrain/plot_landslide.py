"""
A moving landslide
==================

A slab of mud lets go and flows down a slope. Its surface is the ground's plus its thickness, so the
terrain changes where it is, and ``LevelOfDetail.update`` renews that part: triangles get small under
the front and large again behind it.

The model is Voellmy's, of 1955, that avalanches are still computed with: the speed at which the
slope's pull, dry friction and drag are in balance. It moves mud from cell to cell, so none is lost or
made. What it leaves out is inertia.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation

import rtin
from rtin.viewer.pictures import picture
from rtin.viewer.scene import Place, Settings, Terrain, View, usual_painters

CELL = 20.0  # metres
FRICTION = 0.12  # mud rests on slopes below
DRAG = 400.0  # metres per second squared: the turbulent friction of Voellmy's fluid
MOST = 0.2  # of what is in a cell, through one of its four sides in a step


def flux(surface, steepness, mud, seconds):
    """Return what moves to the next column in a step, in metres of thickness."""
    drop = (surface[:, :-1] - surface[:, 1:]) / CELL
    steep = np.maximum((steepness[:, :-1] + steepness[:, 1:]) / 2.0, np.abs(drop)) + 1e-9
    source = np.where(drop > 0.0, mud[:, :-1], mud[:, 1:])  # mud comes from the higher side
    speed = np.sqrt(DRAG * source * np.maximum(steep - FRICTION, 0.0)) * np.abs(drop) / steep
    share = np.minimum(speed * seconds / CELL, MOST)
    # No more than what lets the surface stay higher on that side, with four sides at work.
    return np.sign(drop) * np.minimum(share * source, np.abs(drop) * CELL / 8.0)


def flow(ground, mud, seconds):
    """Return the thickness of the mud a step later; its sum stays."""
    surface = ground + mud
    steepness = np.hypot(*np.gradient(surface, CELL))
    after = mud.copy()
    for turn in (np.asarray, np.transpose):
        moved = flux(turn(surface), turn(steepness), turn(mud), seconds)
        turn(after)[:, :-1] -= moved
        turn(after)[:, 1:] += moved
    return after


def valley(n):
    """Return a slope with a gully that ends on a plain, n × n heights in metres."""
    down, across = np.mgrid[0:n, 0:n] * CELL
    middle = 0.5 * n * CELL + 150.0 * np.sin(down / 420.0)
    slope = 700.0 * np.exp(-((down / (0.42 * n * CELL)) ** 2))
    gully = 60.0 * np.exp(-(((across - middle) / 160.0) ** 2)) * (slope / 700.0) ** 0.5
    return slope - gully + 100.0


def release(n):
    """Return the thickness of the slab at first."""
    down, across = np.mgrid[0:n, 0:n] * CELL
    r = np.hypot(down - 0.12 * n * CELL, across - 0.54 * n * CELL) / (0.1 * n * CELL)
    return 14.0 * np.maximum(1.0 - r**2, 0.0)


def settle(lod, ground, before, mud):
    """Put the mud on the ground where its thickness has changed; return the patch."""
    changed = np.abs(mud - before) > 1e-3
    rows, cols = (
        slice(where[0], where[-1] + 1)
        for where in (np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0)))
    )
    before[rows, cols] = mud[rows, cols]
    lod.update(rows, cols, (ground + mud)[rows, cols])
    return rows, cols


# %%

N = 129
ground, mud = valley(N), release(N)
drawn = mud.copy()
lod = rtin.LevelOfDetail(rtin.Grid(ground + mud, transform=(CELL, 0, 0, 0, -CELL, 0)))
meshes, layers = [lod.mesh(max_error=0.5)], [mud]
for _ in range(15):
    for _ in range(80):
        mud = flow(ground, mud, seconds=0.05)
    settle(lod, ground, drawn, mud)
    meshes.append(lod.mesh(max_error=0.5))
    layers.append(mud)
print(
    f"Mud: {layers[0].sum() * CELL**2:,.0f} m³ at first, {mud.sum() * CELL**2:,.0f} m³ at the end."
)


def painter(mud):
    """Return what colours a mesh: its relief, brown where there is mud."""

    def paint(mesh):
        thickness = mud[tuple((np.abs(mesh.vertices[:, 1::-1]) / CELL).astype(int).T)]
        share = np.minimum(thickness / 3.0, 1.0)[:, np.newaxis]
        return (1.0 - 0.8 * share) * relief(mesh) + 0.8 * share * np.array([0.42, 0.25, 0.13])

    return paint


relief = usual_painters(meshes[0], None)["hillshade"]
place = Place(np.array([1280.0, -1280.0, 350.0]), scale=100.0 / 2560.0)
view = View((42.0, -88.0, 50.0), (2.0, -2.0, -4.0), field_of_view=44.0)
look = Settings(wireframe=True)
pictures = [
    picture(
        Terrain(mesh, place=place, painters={"mud": painter(layer)}),
        view,
        settings=look,
        size=(800, 500),
    )
    for mesh, layer in zip(meshes, layers, strict=True)
]

fig = plt.figure(figsize=(7.2, 4.5))
ax = fig.add_axes((0, 0, 1, 1))
ax.set_axis_off()
image = ax.imshow(pictures[6])
caption = ax.text(20, 40, "", fontsize=13)


def show(moment):
    image.set_data(pictures[moment])
    caption.set_text(f"{4 * moment} s: {meshes[moment].n_triangles:,} triangles within 0.5 m")


film = FuncAnimation(fig, show, len(pictures), interval=250)
plt.show()

# %%
# How thick the mud lies, and the slope under it every 50 m of height:

fig, axes = plt.subplots(1, 4, figsize=(10, 3.2), layout="constrained", sharey=True)
for ax, moment in zip(axes, [0, 4, 8, 15], strict=True):
    thickness = np.where(layers[moment] > 0.05, layers[moment], np.nan)
    mapped = ax.imshow(thickness, cmap="YlOrBr", vmin=-1.0, vmax=10.0)
    ax.contour(ground, np.arange(0, 900, 50), colors="#5a6b5a", linewidths=0.5)
    ax.set(title=f"{4 * moment} s", xlim=(25, 105), ylim=(110, 0), xticks=[], yticks=[])
fig.colorbar(mapped, ax=axes, label="mud (m)", shrink=0.9)
plt.show()
