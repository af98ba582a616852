"""
Craters
=======

Each impact digs a paraboloid and throws what it digs out over the ground around, as thick as
the inverse cube of the distance. ``LevelOfDetail.update`` renews the hierarchy for the patch that has
changed: the next mesh is that of a hierarchy made afresh, to the byte.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation

import rtin
from rtin.viewer.pictures import picture
from rtin.viewer.scene import Place, Settings, Terrain, View, usual_painters


def crater(radius, depth, reach=4.0):
    """Return the change of heights around an impact; radius in cells, volume kept."""
    far = int(reach * radius)
    y, x = np.mgrid[-far : far + 1, -far : far + 1]
    r = np.hypot(x, y) / radius
    bowl = np.minimum(depth * (r**2 - 1.0), 0.0)
    blanket = np.where(r < 1.0, r**2, np.maximum(r, 1.0) ** -3 - reach**-3).clip(0.0)
    return bowl - bowl.sum() / blanket.sum() * blanket


def strike(lod, row, col, change):
    """Change the heights around a sample, as far as they lie on the raster; return the patch."""
    far = len(change) // 2
    (top, left), (bottom, right) = np.clip(
        [[row - far, col - far], [row + far + 1, col + far + 1]], 0, lod.grid.shape
    )
    rows, cols = slice(top, bottom), slice(left, right)
    part = change[top - row + far : bottom - row + far, left - col + far : right - col + far]
    lod.update(rows, cols, lod.grid.heights[rows, cols] + part)
    return rows, cols


# %%
# The ground before: gentle waves of many lengths, 513 × 513 samples 10 m apart. Craters are a fifth
# as deep as they are wide, as fresh ones on the Moon.

rng = np.random.default_rng(5)
rows, cols = np.mgrid[0:513, 0:513]
ground = 500.0 + sum(
    0.02 * length * np.cos(2.0 * np.pi * (np.cos(a) * cols + np.sin(a) * rows) / length + phase)
    for length in [30, 50, 90, 160, 300]
    for a, phase in rng.uniform(0.0, 2.0 * np.pi, (6, 2))
)
lod = rtin.LevelOfDetail(rtin.Grid(ground, transform=(10.0, 0.0, 0.0, 0.0, -10.0, 0.0)))

meshes = [lod.mesh(max_triangles=15_000)]
for radius in [14, 9, 34, 12, 20, 8, 48, 10, 16, 26, 9, 7]:
    strike(lod, *rng.integers(60, 453, 2), crater(radius, depth=4.0 * radius))
    meshes.append(lod.mesh(max_triangles=15_000))

# %%

place = Place(np.array([2560.0, -2560.0, 500.0]), scale=100.0 / 5120.0)
painters = usual_painters(meshes[-1], None)  # one scale of colours for all
view = View((0.0, -62.0, 38.0), (0.0, -9.0, 0.0), field_of_view=54.0)
look = Settings(wireframe=True, exaggeration=1.5)
pictures = [
    picture(Terrain(mesh, place=place, painters=painters), view, settings=look, size=(800, 500))
    for mesh in meshes
]

fig = plt.figure(figsize=(7.2, 4.5))
ax = fig.add_axes((0, 0, 1, 1))
ax.set_axis_off()
image = ax.imshow(pictures[-1])
film = FuncAnimation(fig, lambda frame: image.set_data(frame), pictures, interval=500)
plt.show()

# %%
# From above, the last mesh; a hierarchy made afresh has the same.

afresh = rtin.LevelOfDetail(lod.grid).mesh(max_triangles=15_000)
assert afresh.vertices.tobytes() == meshes[-1].vertices.tobytes()

fig, ax = plt.subplots(figsize=(7, 6.4), layout="constrained")
rtin.plot(meshes[-1], grid=lod.grid, ax=ax, line_width=0.25)
ax.set(title="15,000 triangles after twelve impacts", xlabel="x (m)", ylabel="y (m)")
plt.show()
