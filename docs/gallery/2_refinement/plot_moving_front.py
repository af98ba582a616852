"""
A mesh that follows a moving front
==================================

``AdaptiveMesh`` refines where a fire burns and coarsens before and behind it, and carries a field
along: what has burned stays burned. Each step takes time in proportion to what changes.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation

import rtin
from rtin.studies.propagation import uniform_mesh

FINEST = 8  # bisections of a triangle of the first mesh, which has 8 x 8 squares


def beyond(mesh, radius):
    """Return how far the middle of each triangle is beyond a front with that radius."""
    x, y, _ = mesh.vertices[mesh.triangles].mean(axis=1).T
    return np.hypot(x, y) - radius * (1.0 + 0.12 * np.sin(9.0 * np.arctan2(y, x)))


def near_front(adaptive, radius):
    """Return which triangles may be cut by the front."""
    sizes = 0.1 * 0.5 ** (adaptive.levels / 2)
    return np.abs(beyond(adaptive.mesh, radius)) < sizes


def follow(adaptive, burned, radius):
    """Move the mesh and the field on to a front; return the field on the triangles there are."""
    for _ in range(2):
        adaptive.coarsen(~near_front(adaptive, radius))
        burned = adaptive.transfer(burned, on="triangles")
    while any(wanted := near_front(adaptive, radius) & (adaptive.levels < FINEST)):
        adaptive.refine(wanted)
        burned = adaptive.transfer(burned, on="triangles")
    return np.maximum(burned, beyond(adaptive.mesh, radius) < 0.0)


# %%

adaptive = rtin.AdaptiveMesh(uniform_mesh(3))
burned = np.zeros(adaptive.n_triangles)
moments = []
for radius in np.linspace(0.15, 1.2, 22):
    burned = follow(adaptive, burned, radius)
    moments.append((adaptive.mesh, burned))

fig, ax = plt.subplots(figsize=(5.6, 5.6), layout="constrained")


def draw(moment):
    mesh, burned = moment
    seen = rtin.to_triangulation(mesh)
    ax.clear()
    ax.tripcolor(seen, facecolors=burned, cmap="YlOrBr", vmin=-0.1, vmax=1.6)
    ax.triplot(seen, color="#33414d", linewidth=0.25)
    ax.set(aspect="equal", xticks=[], yticks=[])
    ax.set_title(f"{mesh.n_triangles:,} triangles, {burned @ mesh.signed_areas():.1%} burned")


film = FuncAnimation(fig, draw, moments, interval=200)
plt.show()

# %%
# Triangles as small everywhere would be 32,768.

_, chart = plt.subplots(figsize=(7, 3.2), layout="constrained")
chart.plot([mesh.n_triangles for mesh, _ in moments], "o-", color="#b5543c")
chart.set(xlabel="step", ylabel="triangles", ylim=(0, None))
chart.set_title("The mesh grows with the front, not with the ground")
chart.grid(alpha=0.3)
plt.show()
