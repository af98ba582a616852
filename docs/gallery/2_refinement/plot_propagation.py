"""
How far a refinement propagates
===============================

To stay conforming, refining a triangle has to split others. M1 counts them, M2 is the longest of the
three walks along longest edges. Both are found without refining anything.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin.studies.propagation import uniform_mesh

adaptive = rtin.AdaptiveMesh(uniform_mesh(3))
rng = np.random.default_rng(1)
for _ in range(250):
    adaptive.refine([rng.integers(adaptive.n_triangles)])
mesh = adaptive.mesh
m1, m2 = rtin.propagation(mesh)

fig, axes = plt.subplots(1, 2, figsize=(10, 4.8), layout="constrained")
for ax, values, name in [(axes[0], m1, "M1: others split"), (axes[1], m2, "M2: longest walk")]:
    image = ax.tripcolor(rtin.to_triangulation(mesh), facecolors=values, cmap="YlGnBu")
    ax.triplot(rtin.to_triangulation(mesh), color="#33414d", linewidth=0.25)
    ax.set(title=f"{name}, {values.mean():.1f} on average", aspect="equal", xticks=[], yticks=[])
    fig.colorbar(image, ax=ax, label="triangles", shrink=0.9)
plt.show()

# %%
# The triangles that are split if the worst one is refined:

worst = int(m1.argmax())
before = {tuple(corners) for corners in rtin.refine(mesh, [worst]).triangles.tolist()}
split = np.array([tuple(corners) not in before for corners in mesh.triangles.tolist()])
shade = split + 1.0 * (np.arange(mesh.n_triangles) == worst)

fig, ax = plt.subplots(figsize=(6, 5.6), layout="constrained")
ax.tripcolor(rtin.to_triangulation(mesh), facecolors=shade, cmap="Oranges", vmax=2.6)
ax.triplot(rtin.to_triangulation(mesh), color="#33414d", linewidth=0.8)
west, south, _ = mesh.vertices[mesh.triangles[split]].min(axis=(0, 1)) - 0.02
east, north, _ = mesh.vertices[mesh.triangles[split]].max(axis=(0, 1)) + 0.02
ax.set(aspect="equal", xlim=(west, east), ylim=(south, north), xticks=[], yticks=[])
ax.set_title(f"Refining the dark one splits {split.sum() - 1} others: M1 = {m1[worst]}")
plt.show()
