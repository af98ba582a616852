"""
The least sum of squares
========================

With ``norm="rms"`` a budget makes the root mean square of the errors small, not the largest error: a
few single samples may be farther off, most are nearer.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

grid = samples.jacksboro_fault()
meshes = {
    "the smallest largest error": rtin.coarsen(grid, max_vertices=4000),
    "the smallest sum of squares": rtin.coarsen(grid, max_vertices=4000, norm="rms"),
}

fig, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained", sharey=True)
for ax, (name, mesh) in zip(axes, meshes.items(), strict=True):
    rtin.plot(mesh, grid=grid, ax=ax)
    error = rtin.vertical_error(mesh, grid)
    ax.set_title(f"{name}\nmax {error.max:.0f} m, rms {error.rms:.1f} m", fontsize=10)
    ax.set_ylabel("")
fig.suptitle("4,000 vertices each")
plt.show()

# %%

fig, ax = plt.subplots(figsize=(7, 3.8), layout="constrained")
for (name, mesh), colour in zip(meshes.items(), ["#b5543c", "#4c7a8c"], strict=True):
    errors = np.sort(np.abs(rtin.vertical_error(mesh, grid).field), axis=None)
    ax.plot(errors, 100.0 * np.arange(1, errors.size + 1) / errors.size, label=name, color=colour)
ax.set(xlabel="vertical error (m)", ylabel="samples within it (%)", xlim=(0, 120), ylim=(0, 101))
ax.set_title("Most samples nearer, a few farther off")
ax.grid(alpha=0.3)
ax.legend(loc="lower right")
plt.show()
