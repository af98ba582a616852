"""
Detail where it matters
=======================

A tolerance for each sample looks closely at what counts: here along a road across the hills. ``keep``
holds single vertices whatever the tolerance says: here the summits.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import maximum_filter

import rtin
from rtin import samples

grid = samples.jacksboro_fault()
rows, cols = np.mgrid[: grid.shape[0], : grid.shape[1]]

road = 170 + 60 * np.sin(cols / 60)  # its row in each column
tolerance = np.clip(3.0 * np.abs(rows - road), 8.0, 120.0)
summits = (grid.heights == maximum_filter(grid.heights, 31)) & (grid.heights > 700.0)

mesh = rtin.coarsen(grid, max_error=tolerance, keep=summits)
error = np.abs(rtin.vertical_error(mesh, grid).field)
print(f"{np.mean(error <= tolerance):.0%} of the samples lie within their own tolerance.")

# %%

fig, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
image = axes[0].imshow(tolerance, cmap="YlGnBu_r")
axes[0].plot(*np.nonzero(summits)[::-1], "^", color="#b5543c", label="kept summits")
axes[0].set(title="The tolerance asked for", xticks=[], yticks=[])
axes[0].legend(loc="lower right")
fig.colorbar(image, ax=axes[0], label="tolerance (m)", shrink=0.8)
rtin.plot(mesh, grid=grid, ax=axes[1], line_width=0.3)
axes[1].set_title(f"The mesh: {mesh.n_triangles:,} triangles")
plt.show()
