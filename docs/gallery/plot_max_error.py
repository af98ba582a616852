"""
A mesh within a tolerance
=========================

The least right-triangulated mesh in which no sample is farther than 50 m from its triangle: large
triangles in the valley, small ones on the ridges.
"""

import matplotlib.pyplot as plt

import rtin
from rtin import samples

grid = samples.jacksboro_fault()
mesh = rtin.coarsen(grid, max_error=50.0)

fig, ax = plt.subplots(figsize=(8, 6), layout="constrained")
rtin.plot(mesh, grid=grid, ax=ax)
ax.set_title(f"{mesh.n_triangles:,} triangles for {grid.n_samples:,} samples, within 50 m")
plt.show()
