"""
As good as a budget allows
==========================

``max_triangles`` gives the mesh of the smallest error that fits. 257 × 257 samples fill the lattice of
right triangles, so that even a few triangles can cover them.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

whole = samples.jacksboro_fault()
grid = rtin.Grid(whole.heights[:257, :257], whole.transform, whole.crs)
budgets = 100 * 2 ** np.arange(10)
meshes = [rtin.coarsen(grid, max_triangles=budget) for budget in budgets]
errors = [rtin.vertical_error(mesh, grid) for mesh in meshes]

fig, axes = plt.subplots(1, 3, figsize=(10, 3.7), layout="constrained", sharey=True)
for ax, i in zip(axes, [0, 3, 5], strict=True):
    rtin.plot(meshes[i], ax=ax)
    ax.set(title=f"{budgets[i]:,} triangles: {errors[i].max:.0f} m", ylabel="")
    ax.locator_params(nbins=4)
plt.show()

# %%

fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
ax.loglog(budgets, [error.max for error in errors], "o-", color="#7b3f2b", label="largest error")
ax.loglog(budgets, [error.rms for error in errors], "o-", color="#4c7a8c", label="root mean square")
ax.set(xlabel="triangles", ylabel="vertical error (m)", title="What more triangles buy")
ax.grid(alpha=0.3, which="both")
ax.legend()
plt.show()
