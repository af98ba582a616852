"""
The paper's criterion beside a guaranteed error
===============================================

Eq. (1) of Suárez and Plaza measures how far a vertex is from the middle of the edge that it
bisects. Removing all vertices below a threshold promises nothing about the surface, since the
errors of what is removed add up. ``max_error`` looks at every sample instead. Here both have as many
vertices.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

grid = samples.jacksboro_fault()
by_threshold = rtin.coarsen(grid, threshold=50.0)
guaranteed = rtin.coarsen(grid, max_vertices=by_threshold.n_vertices)
errors = {
    "threshold=50, Eq. (1)": rtin.vertical_error(by_threshold, grid),
    "the smallest max_error": rtin.vertical_error(guaranteed, grid),
}

fig, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for ax, (name, error) in zip(axes, errors.items(), strict=True):
    image = ax.imshow(np.abs(error.field[150:290, 60:260]), cmap="magma_r", vmax=100.0)
    ax.set(title=f"{name}: at most {error.max:.0f} m", xticks=[], yticks=[])
fig.colorbar(image, ax=axes, label="vertical error (m)", extend="max")
fig.suptitle(f"{by_threshold.n_vertices:,} vertices, chosen in two ways; a part of the terrain")
plt.show()

# %%
# All samples of both:

fig, ax = plt.subplots(figsize=(7, 3.6), layout="constrained")
bins = np.linspace(0.0, 110.0, 56)
for (name, error), colour in zip(errors.items(), ["#b5543c", "#4c7a8c"], strict=True):
    ax.hist(
        np.abs(error.field).ravel(), bins, histtype="step", label=name, color=colour, linewidth=1.8
    )
ax.set(yscale="log", xlabel="vertical error (m)", ylabel="samples", xlim=(0, 110))
ax.set_title("The threshold has a tail, the guarantee an end")
ax.legend()
plt.show()
