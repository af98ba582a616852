"""
Fewer vertices, better heights
==============================

Two triangles that share a hypotenuse make a square, which can be cut along either diagonal:
``diagonals="best"`` keeps the same promise with fewer vertices. ``heights="fitted"`` moves vertices up
or down, within the promise, for the least sum of squared errors.
"""

import matplotlib.pyplot as plt

import rtin
from rtin import samples

grid = samples.topobathy()
plain = rtin.coarsen(grid, max_error=150.0)
best = rtin.coarsen(grid, max_error=150.0, diagonals="best")
fitted = rtin.coarsen(grid, max_error=150.0, diagonals="best", heights="fitted")

fig, axes = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained", sharey=True)
for ax, mesh, name in [
    (axes[0], plain, "the lattice's diagonals"),
    (axes[1], best, "the better one of each square"),
]:
    rtin.plot(mesh, grid=grid, ax=ax, line_width=0.5)
    ax.set(title=f"{name}: {mesh.n_vertices:,} vertices", ylabel="")
fig.suptitle("Within 150 m: a coast, and the sea floor before it")
plt.show()

# %%
# The error of each mesh, all within the same tolerance. The fitted one is no longer biased: its
# errors gather round zero.

fig, axes = plt.subplots(1, 3, figsize=(10, 3), layout="constrained", sharey=True)
meshes = {"lattice": plain, "best": best, "best, fitted": fitted}
for ax, (name, mesh) in zip(axes, meshes.items(), strict=True):
    error = rtin.vertical_error(mesh, grid)
    image = ax.imshow(error.field, cmap="RdBu_r", vmin=-150, vmax=150)
    ax.set_title(
        f"{name}: {mesh.n_vertices:,} vertices,\nmax {error.max:.0f} m, rms {error.rms:.0f} m",
        fontsize=10,
    )
    ax.set(xticks=[], yticks=[])
fig.colorbar(image, ax=axes, label="surface − sample (m)", shrink=0.9)
plt.show()
