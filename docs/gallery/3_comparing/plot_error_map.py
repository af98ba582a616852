"""
Where a mesh is off
===================

``vertical_error`` compares a mesh with all samples of a raster: the largest difference and where it is,
the root mean square, and a map.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

grid = samples.jacksboro_fault()
mesh = rtin.coarsen(grid, max_error=60.0)
error = rtin.vertical_error(mesh, grid)
print(error)

fig, axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
window = np.s_[60:200, 60:230]
image = axes[0].imshow(error.field[window], cmap="RdBu_r", vmin=-60, vmax=60)
axes[0].set(title="Surface − sample, a part of the map", xticks=[], yticks=[])
fig.colorbar(image, ax=axes[0], label="m", shrink=0.8)
axes[1].hist(error.field.ravel(), np.arange(-62, 63, 2), color="#8fb0bd")
axes[1].axvline(-60, color="#b5543c")
axes[1].axvline(60, color="#b5543c", label="max_error")
axes[1].set(xlabel="surface − sample (m)", ylabel="samples", title=f"rms {error.rms:.1f} m")
axes[1].legend()
plt.show()
