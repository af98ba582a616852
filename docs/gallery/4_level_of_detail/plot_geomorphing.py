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
path = np.linspace([-9000.0, -12000.0, 2500.0], [-7600.0, -8500.0, 1800.0], 60)
frames = [lod.frame(eye, pixel_error=4.0) for eye in path]

# %%
# The weights of one frame. Most vertices have come to rest; those on the way are spread all over.

frame = frames[0]
fig, ax = plt.subplots(figsize=(8, 6.4), layout="constrained")
ax.triplot(rtin.to_triangulation(frame.mesh), color="#33414d", linewidth=0.15)
dots = ax.scatter(*frame.mesh.vertices[:, :2].T, c=frame.weights, s=7, cmap="viridis", zorder=2)
ax.plot(*path[:, :2].T, color="#b5543c", linewidth=3.0, label="where the eye flies")
ax.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
ax.set_title(f"{np.mean(frame.weights < 1.0):.0%} of {len(frame.weights):,} vertices are on their way")
ax.legend(loc="upper right")
fig.colorbar(dots, label="weight", shrink=0.8)
plt.show()

# %%
# How far any sample of the surface moves on the screen from one frame to the next, when vertices pop
# up and when they morph:


def surface(mesh):
    """Return the height of a mesh at each sample."""
    return grid.heights + rtin.vertical_error(mesh, grid).field


def jumps(meshes):
    """Return the largest change of the surface between frames, in pixels."""
    surfaces = [surface(mesh) for mesh in meshes]
    rows, cols = np.mgrid[: grid.shape[0], : grid.shape[1]]
    x, y = grid.transform.a * cols + grid.transform.c, grid.transform.e * rows + grid.transform.f
    return [
        np.max(
            np.abs(after - before)
            / np.sqrt((x - eye[0]) ** 2 + (y - eye[1]) ** 2 + (grid.heights - eye[2]) ** 2)
        )
        * 1080 / (2.0 * np.tan(np.radians(30.0)))
        for before, after, eye in zip(surfaces, surfaces[1:], path[1:], strict=False)
    ]  # fmt: skip


fig, ax = plt.subplots(figsize=(7, 3.8), layout="constrained")
ax.plot(jumps([frame.mesh for frame in frames]), color="#b5543c", label="frame.mesh")
ax.plot(jumps([frame.morphed for frame in frames]), color="#4c7a8c", label="frame.morphed")
ax.set(xlabel="frame", ylabel="largest jump (pixels)", ylim=(0, None), title="60 m from frame to frame")
ax.legend()
ax.grid(alpha=0.3)
plt.show()
