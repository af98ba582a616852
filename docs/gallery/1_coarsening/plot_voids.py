"""
Coasts and islands
==================

NaN is void: nothing is known there, or nothing wanted. The mesh covers exactly what has heights,
whatever its shape, with small triangles along the outline only. Here the sea is taken away.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

whole = samples.topobathy()
land = rtin.Grid(np.where(whole.heights > 0.0, whole.heights, np.nan), whole.transform, whole.crs)
mesh = rtin.coarsen(land, max_error=100.0)

fig, ax = plt.subplots(figsize=(8, 6), layout="constrained")
rtin.plot(mesh, ax=ax, line_width=0.4)
ax.set_title(f"Land only: {mesh.n_triangles:,} triangles, within 100 m")
ax.set_facecolor("#dce9f0")
plt.show()

# %%
# Invented islands, from noise that falls off towards the border of an odd-shaped raster:

rng = np.random.default_rng(11)
rows, cols = np.mgrid[0:300, 0:480]
heights = np.zeros(rows.shape)
for wavelength in 160.0 / 2.0 ** np.arange(6):
    angles, phases = rng.uniform(0.0, 2.0 * np.pi, (2, 12))
    for angle, phase in zip(angles, phases, strict=True):
        along = np.cos(angle) * cols + np.sin(angle) * rows
        heights += wavelength**1.25 * np.cos(2.0 * np.pi * along / wavelength + phase)
heights -= 500.0 * ((cols / 240 - 1) ** 4 + (rows / 150 - 1) ** 4)
islands = rtin.Grid(np.where(heights > 150.0, heights, np.nan))
mesh = rtin.coarsen(islands, max_error=60.0)

fig, ax = plt.subplots(figsize=(8, 5), layout="constrained")
rtin.plot(mesh, ax=ax, line_width=0.3)
ax.set(title=f"{mesh.n_triangles:,} triangles, none of them in the sea", facecolor="#dce9f0")
plt.show()
