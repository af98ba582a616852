"""
Two ways to cut a triangle in four
==================================

4T-LE bisects the longest edge first and joins its middle to the corner and the other two middles;
4T-SS swaps the inner edge and makes four triangles like the whole. Neighbours are split, too, as
far as a conforming mesh asks. Any triangles will do: here those of a Delaunay triangulation.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.tri import Triangulation

import rtin

rng = np.random.default_rng(4)
rows, cols = np.mgrid[0:6, 0:6]
inner = (rows % 5 > 0) & (cols % 5 > 0)
x, y = np.array([cols, rows]) / 5 + inner * rng.uniform(-0.05, 0.05, (2, 6, 6))
mesh = rtin.from_triangulation(Triangulation(x.ravel(), y.ravel()), np.zeros(36))


def touches_circle(mesh):
    """Return which triangles reach over a circle."""
    radii = np.hypot(*(mesh.vertices[mesh.triangles, :2] - 0.5).transpose(2, 0, 1))
    return (radii.min(axis=1) < 0.3) & (radii.max(axis=1) > 0.3)


fig, axes = plt.subplots(2, 3, figsize=(9.5, 6.6), layout="constrained")
for row, scheme in zip(axes, ["4T-LE", "4T-SS"], strict=True):
    refined = mesh
    for ax in row:
        marked = touches_circle(refined)
        ax.tripcolor(
            rtin.to_triangulation(refined), facecolors=marked + 0.0, cmap="Oranges", vmax=2.5
        )
        ax.triplot(rtin.to_triangulation(refined), color="#33414d", linewidth=0.5)
        ax.set(aspect="equal", xticks=[], yticks=[])
        ax.set_title(f"{scheme}: {refined.n_triangles:,} triangles", fontsize=10)
        refined = rtin.refine(refined, marked, scheme=scheme)
fig.suptitle("Refined along a circle; what is marked is split in the next step")
plt.show()

# %%
# How sharp the angles get. Longest edges keep the smallest angle above half of what it was
# at first, however often they are cut.


def smallest_angles(mesh):
    """Return the smallest angle of each triangle, in degrees."""
    corners = mesh.vertices[mesh.triangles]
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    lengths = np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    return np.degrees(np.arccos(np.sum(ahead * back, axis=2) / lengths)).min(axis=1)


fig, ax = plt.subplots(figsize=(7, 3.6), layout="constrained")
ax.hist(smallest_angles(mesh), np.arange(0, 62, 2), density=True, color="#c9ced3", label="at first")
for scheme, colour in [("4T-LE", "#b5543c"), ("4T-SS", "#4c7a8c")]:
    refined = mesh
    for _ in range(5):
        refined = rtin.refine(refined, touches_circle(refined), scheme=scheme)
    angles = smallest_angles(refined)
    ax.hist(
        angles,
        np.arange(0, 62, 2),
        density=True,
        histtype="step",
        linewidth=1.8,
        color=colour,
        label=f"{scheme}, 5 times: {angles.min():.1f}° or more",
    )
ax.set(xlabel="smallest angle of a triangle (degrees)", ylabel="share (per degree)")
ax.legend()
plt.show()
