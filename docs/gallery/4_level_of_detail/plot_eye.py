"""
What an eye can tell
====================

``LevelOfDetail`` prepares a hierarchy once and then cuts a mesh for any view: inside the frustum every
sample is within so many pixels of the mesh, outside it triangles are as large as can be.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

grid = samples.jacksboro_fault().in_metres()
lod = rtin.LevelOfDetail(grid)

eye, target = np.array([-6000.0, -13500.0, 1500.0]), np.array([1000.0, 0.0, 400.0])
seen = rtin.frustum(eye, target, field_of_view=40.0, aspect=1.5)
mesh = lod.mesh(eye, pixel_error=2.0, field_of_view=40.0, height=720, frustum=seen)

# %%
# From above. The lines are the sides of the picture.


def draw_eye(ax):
    """Draw the eye and what it sees, left and right."""
    for left, right in [(seen[0], seen[1]), (seen[1], seen[0])]:
        along = np.cross(left[:3], [0.0, 0.0, 1.0])
        along *= np.sign(along @ right[:3])
        ax.plot(*np.array([eye, eye + 6e4 * along])[:, :2].T, color="#b5543c", linewidth=1.2)
    ax.plot(*eye[:2], "o", color="#b5543c", markersize=8)


def draw_sizes(ax, mesh):
    """Draw the triangles, coloured by the length of their legs; return what was drawn."""
    legs = np.log2(np.sqrt(2.0 * mesh.signed_areas()))
    plan = rtin.to_triangulation(mesh)
    drawn = ax.tripcolor(plan, facecolors=legs, cmap="YlGnBu_r", vmin=6.0, vmax=12.5)
    ax.triplot(plan, color="#33414d", linewidth=0.15)
    west, south, _ = mesh.bounds[0]
    ax.set(aspect="equal", xlim=(west, -west), ylim=(south, -south), xlabel="x (m)")
    return drawn


fig, ax = plt.subplots(figsize=(8, 6.8), layout="constrained")
drawn = draw_sizes(ax, mesh)
draw_eye(ax)
ax.set(ylabel="y (m)", title=f"{mesh.n_triangles:,} triangles, within two pixels in the picture")
bar = fig.colorbar(drawn, label="legs of a triangle (m)", shrink=0.9)
bar.set_ticks(range(6, 13), labels=[f"{2**n:,}" for n in range(6, 13)])
plt.show()

# %%
# A budget instead: the best mesh of so many triangles for this eye. The pixel error says how good
# that is.

fig, axes = plt.subplots(1, 3, figsize=(10, 3.8), layout="constrained", sharey=True)
for ax, budget in zip(axes, [500, 2000, 8000], strict=True):
    frame = lod.frame(eye, max_triangles=budget, field_of_view=40.0, height=720, frustum=seen)
    draw_sizes(ax, frame.mesh)
    draw_eye(ax)
    ax.locator_params(nbins=4)
    ax.set_title(f"{budget:,} triangles: {frame.pixel_error:.1f} pixels", fontsize=10)
plt.show()
