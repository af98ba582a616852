"""
Nothing pops
============

When an eye moves, triangles come and go. A frame gives each vertex a weight: 0 where it begins, on
the surface that was there before, and 1 where it has come to its own height. Drawn so, the ground
moves, but never jumps, and both surfaces keep the pixel error.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

grid = samples.jacksboro_fault().in_metres()
lod = rtin.LevelOfDetail(grid)
start, end = np.array([[-9000.0, -12000.0, 2500.0], [-6000.0, -3000.0, 1800.0]])
frame = lod.frame(start, pixel_error=4.0)

# %%
# The vertices of one frame that are on their way; all others have come to rest.

moving = frame.weights < 1.0
fig, ax = plt.subplots(figsize=(8, 6.4), layout="constrained")
ax.triplot(rtin.to_triangulation(frame.mesh), color="#9aa5ad", linewidth=0.2)
x, y, _ = frame.mesh.vertices[moving].T
dots = ax.scatter(x, y, c=frame.weights[moving], s=14, cmap="viridis", zorder=2)
ax.plot(*np.array([start, end])[:, :2].T, color="#b5543c", linewidth=2.5, label="the eye's way")
ax.plot(*start[:2], "o", color="#b5543c")
ax.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
ax.set_title(f"{moving.sum():,} of {len(moving):,} vertices are on their way")
ax.legend(loc="upper right")
fig.colorbar(dots, label="weight", shrink=0.8)
plt.show()

# %%
# How far any sample of the surface jumps on the screen from one frame to the next. The smaller the
# eye's step, the less the morphed surface moves; without weights some vertex always pops by nearly the
# whole tolerance.

rows, cols = np.mgrid[: grid.shape[0], : grid.shape[1]]
x = grid.transform.a * cols + grid.transform.c
y = grid.transform.e * rows + grid.transform.f
ground = np.dstack([x, y, grid.heights])


def jump(before, after, eye):
    """Return the largest change of the surface at a sample, in pixels."""
    change = rtin.vertical_error(after, grid).field - rtin.vertical_error(before, grid).field
    pixels = 1080 / (2.0 * np.tan(np.radians(30.0))) / np.linalg.norm(ground - eye, axis=2)
    return np.max(np.abs(change) * pixels)


steps = 1.5 * 2.0 ** np.arange(8)
forward = (end - start) / np.linalg.norm(end - start)
popped, morphed = np.zeros((2, len(steps)))
for i, step in enumerate(steps):
    for eye in np.linspace(start, end, 5):
        one, two = (lod.frame(at, pixel_error=4.0) for at in (eye, eye + step * forward))
        popped[i] = max(popped[i], jump(one.mesh, two.mesh, eye))
        morphed[i] = max(morphed[i], jump(one.morphed, two.morphed, eye))

_, chart = plt.subplots(figsize=(7, 3.8), layout="constrained")
chart.loglog(steps, popped, "o-", color="#b5543c", label="frame.mesh")
chart.loglog(steps, morphed, "o-", color="#4c7a8c", label="frame.morphed")
chart.set(xlabel="step of the eye (m)", ylabel="largest jump (pixels)", title="Within four pixels")
chart.legend()
chart.grid(alpha=0.3, which="both")
plt.show()
