"""
Beside other simplifiers
========================

``rtin.simplifiers`` asks other people's libraries, where they are installed, for a mesh of as many
vertices: the least right-triangulated mesh, the paper's criterion, every n-th sample, and VTK's
collapse of edges by quadric error. Triangles of any shape get nearer to the ground; right ones can be
made coarser and finer again in place, and come in nested levels.
"""

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples
from rtin.simplifiers import SIMPLIFIERS, simplify

whole = samples.jacksboro_fault().in_metres()
grid = rtin.Grid(whole.heights[87:344, 0:257], whole.transform)
names = ["rtin", "threshold", "subsample", "vtk-quadric"]
meshes = {name: simplify(grid, name, max_vertices=4300) for name in names}
errors = {name: rtin.vertical_error(mesh, grid) for name, mesh in meshes.items()}

fig, axes = plt.subplots(2, 4, figsize=(11, 5.8), layout="constrained")
for (above, below), name in zip(axes.T, names, strict=True):
    mesh, error = meshes[name], errors[name]
    rtin.plot(mesh, ax=above, line_width=0.35)
    above.set(xlim=(-11000, -6000), ylim=(2000, 7000), xlabel="", ylabel="", xticks=[], yticks=[])
    above.set_title(f"{SIMPLIFIERS[name].label}\n{mesh.n_vertices:,} vertices", fontsize=10)
    image = below.imshow(np.abs(error.field), cmap="magma_r", vmin=0.0, vmax=120.0)
    below.set_title(f"max {error.max:.0f} m, rms {error.rms:.1f} m", fontsize=10)
    below.set(xticks=[], yticks=[])
fig.colorbar(image, ax=axes[1], label="vertical error (m)", extend="max")
plt.show()
