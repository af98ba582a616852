"""
Terrain into a mesh that has to stay
====================================

Some edges are given: a building ground, a shore, the zones of a model. ``refine_to`` splits the
triangles of any mesh until it fits a raster, and keeps all edges that were there.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.tri import Triangulation

import rtin
from rtin import samples

grid = samples.jacksboro_fault()
rows, cols = np.array(
    [[0, 0], [0, 402], [343, 402], [343, 0], [130, 150], [110, 260], [180, 300], [230, 210]]
).T
x = grid.transform.c + grid.transform.a * cols
y = grid.transform.f + grid.transform.e * rows
given = rtin.from_triangulation(Triangulation(x, y), grid.heights[rows, cols])

fitted = rtin.refine_to(given, grid, max_error=60.0)

fig, axes = plt.subplots(1, 2, figsize=(10, 4.6), layout="constrained", sharey=True)
for ax, mesh in zip(axes, [given, fitted], strict=True):
    rtin.plot(mesh, grid=grid, ax=ax, line_width=1.2 if mesh is given else None)
    ax.fill(x[4:], y[4:], fill=False, edgecolor="#b5543c", linewidth=1.8)
    error = rtin.vertical_error(mesh, grid).max
    ax.set_title(f"{mesh.n_triangles:,} triangles, within {error:.0f} m")
    ax.set_ylabel("")
plt.show()
