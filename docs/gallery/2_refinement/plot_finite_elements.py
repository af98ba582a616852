"""
Adaptive finite elements
========================

Laplace's equation on an L-shaped ground: the solution's slope is unbounded at the corner that points
inwards. scikit-fem solves, the jumps of the slope say where the error is, and rtin refines there.
"""

import matplotlib.pyplot as plt
import numpy as np
import skfem
from skfem.helpers import dot, grad
from skfem.models.poisson import laplace

import rtin


def solution(x):
    """Return the exact solution, harmonic and zero on both sides of the corner."""
    angle = np.arctan2(x[1], x[0]) % (2.0 * np.pi)
    return np.hypot(*x) ** (2.0 / 3.0) * np.sin(angle / 1.5)


def solve(mesh):
    """Return the solution by linear elements at the vertices."""
    basis = skfem.Basis(mesh, skfem.ElementTriP1())
    boundary = basis.get_dofs()
    given = np.where(np.isin(np.arange(basis.N), boundary), solution(basis.doflocs), 0.0)
    return skfem.solve(*skfem.condense(laplace.assemble(basis), x=given, D=boundary))


def jumps(mesh, u):
    """Return the estimate of each triangle: h times the squared jump of the slope."""
    sides = [skfem.InteriorFacetBasis(mesh, skfem.ElementTriP1(), side=side) for side in (0, 1)]
    jump = skfem.Functional(lambda w: w.h * dot(grad(w.left) - grad(w.right), w.n) ** 2)
    left, right = (side.interpolate(u) for side in sides)
    on_facets = np.zeros(mesh.facets.shape[1])
    on_facets[sides[0].find] = jump.elemental(sides[0], left=left, right=right)
    return on_facets[mesh.t2f].sum(axis=0)


x, y = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1]]).T
triangles = [[0, 2, 3], [2, 0, 1], [0, 4, 5], [4, 0, 3], [0, 6, 7], [6, 0, 5]]
mesh = rtin.TriangleMesh.from_triangles(np.column_stack([x, y, 0.0 * x]), triangles)
history = []
for _ in range(13):
    elements = rtin.to_skfem(mesh)
    u = solve(elements)
    error = np.abs(u - solution(elements.p)).max()
    history.append((mesh, u, error))
    estimate = jumps(elements, u)
    mesh = rtin.refine(mesh, estimate > 0.25 * estimate.max())

# %%

fig, axes = plt.subplots(1, 3, figsize=(10, 3.7), layout="constrained", sharey=True)
for ax, i in zip(axes, [3, 7, 12], strict=True):
    mesh, u, error = history[i]
    seen = rtin.to_triangulation(mesh)
    image = ax.tripcolor(seen, u, cmap="YlGnBu", shading="gouraud", vmin=0.0, vmax=1.3)
    ax.triplot(seen, color="#33414d", linewidth=0.3)
    ax.set(aspect="equal", xticks=[], yticks=[])
    ax.set_title(f"{mesh.n_vertices:,} vertices, error {error:.4f}", fontsize=10)
fig.colorbar(image, ax=axes, label="u", shrink=0.8)
plt.show()
