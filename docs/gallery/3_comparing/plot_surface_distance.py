"""
How far surfaces are from each other
====================================

On steep ground the nearest point of another surface is not the one above or below. ``compare``
measures that distance from samples, as Metro does; ``hausdorff`` gives bounds of the largest one that
hold.
"""

import matplotlib.pyplot as plt

import rtin
from rtin import samples

whole = samples.jacksboro_fault().in_metres()
grid = rtin.Grid(whole.heights[100:229, 100:229], whole.transform)
mesh = rtin.coarsen(grid, max_error=60.0)

distance = rtin.compare(grid, mesh)
bounds = rtin.hausdorff(grid, mesh)
vertical = rtin.vertical_error(mesh, grid)
print(f"vertical: {vertical.max:.1f} m at most")
print(f"nearest point: {distance.hausdorff:.2f} m in samples")
print(f"Hausdorff distance: between {bounds.lower:.2f} and {bounds.upper:.2f} m")

# %%

fig, axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
points, distances, _ = distance.forward.field
image = axes[0].scatter(
    *points[:, :2].T, c=distances, s=1.2, cmap="magma_r", linewidths=0, rasterized=True
)
axes[0].plot(*bounds.place[:2], "o", mfc="none", mec="#2a6f97", ms=14, mew=2, label="the largest")
axes[0].set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="From the raster to the mesh")
axes[0].legend(loc="upper right")
fig.colorbar(image, ax=axes[0], label="distance (m)", shrink=0.85)

rtin.plot(mesh, grid=grid, ax=axes[1], line_width=0.4)
axes[1].set(
    xlabel="x (m)", title=f"The mesh: {mesh.n_triangles:,} triangles, within 60 m vertically"
)
plt.show()
