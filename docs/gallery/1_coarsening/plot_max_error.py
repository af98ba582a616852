"""
A mesh within a tolerance
=========================

The least right-triangulated mesh in which no sample is farther than 50 m from its triangle: large
triangles in the valleys, small ones on the ridges.
"""

import matplotlib.pyplot as plt

import rtin
from rtin import samples

grid = samples.jacksboro_fault()
mesh = rtin.coarsen(grid, max_error=50.0)

fig, ax = plt.subplots(figsize=(8, 6.4), layout="constrained")
rtin.plot(mesh, grid=grid, ax=ax, line_width=0.35)
ax.set_title(f"{mesh.n_triangles:,} triangles for {grid.n_samples:,} samples, within 50 m")
plt.show()

# %%
# Meshes of one raster are nested: a smaller tolerance keeps all vertices of a larger one. Here
# they are over the middle of the same terrain.

tolerances = [100.0, 50.0, 25.0]
fig, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained", sharey=True)
for ax, tolerance, mesh in zip(
    axes, tolerances, rtin.coarsen_levels(grid, tolerances), strict=True
):
    rtin.plot(mesh, grid=grid, ax=ax, line_width=0.4)
    ax.set(xlim=(-84.33, -84.22), ylim=(36.53, 36.64), ylabel="")
    ax.locator_params(nbins=4)
    ax.set_title(f"within {tolerance:g} m: {mesh.n_triangles:,}", fontsize=10)
plt.show()
