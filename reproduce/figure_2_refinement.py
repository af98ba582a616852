"""Fig. 2 of the paper: 4T-LE refinement of single triangles, and how far it propagates.

    python reproduce/figure_2_refinement.py [PICTURE]

The paper's mesh is not given; this one is a random triangulation of 60 points. Targets are blue,
triangles that have to be split besides them orange. On the right a terrain, refined along a path.
"""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.tri import Triangulation

import rtin
from rtin import samples

COLOURS = ListedColormap(["white", "tab:orange", "tab:blue"])


def random_mesh(n_vertices: int, seed: int) -> rtin.TriangleMesh:
    xy = np.random.default_rng(seed).random((n_vertices, 2))
    return rtin.from_triangulation(Triangulation(*xy.T))


def roles(mesh: rtin.TriangleMesh, target: int) -> np.ndarray:
    """0 for triangles that stay, 1 for those that are split too, 2 for the target."""
    adaptive = rtin.AdaptiveMesh(mesh)
    split = adaptive.refine([target])
    role = np.zeros(mesh.n_triangles)
    role[split[split < mesh.n_triangles]] = 1
    role[target] = 2
    return role


def draw(axes: Axes, mesh: rtin.TriangleMesh, role: np.ndarray, title: str) -> None:
    axes.tripcolor(
        rtin.to_triangulation(mesh), role, cmap=COLOURS, vmin=0, vmax=2, ec="0.35", lw=0.6
    )
    axes.set(title=title, aspect="equal")
    axes.set_axis_off()


def far_reaching(mesh: rtin.TriangleMesh) -> int:
    """The triangle inside with the largest conformity neighbourhood."""
    return int(rtin.propagation(mesh).m1.argmax())


def along_a_path() -> rtin.TriangleMesh:
    """Jacksboro, coarse, and with triangles of at most 16 cells near a winding path."""
    grid = samples.jacksboro_fault()
    largest = 16 * abs(grid.transform.a * grid.transform.e)

    def near_and_large(mesh: rtin.TriangleMesh) -> np.ndarray:
        low, high = mesh.bounds[:, :2]
        x, y = ((mesh.vertices[mesh.triangles].mean(axis=1)[:, :2] - low) / (high - low)).T
        path = 0.5 + 0.2 * np.sin(9 * x)
        return (np.abs(y - path) < 0.02) & (mesh.signed_areas() > largest)

    return rtin.refine(rtin.coarsen(grid, max_error=150.0), near_and_large, heights=grid)


def main(picture: str = "figure-2.png") -> None:
    figure, axes = plt.subplots(1, 4, figsize=(14, 3.6), layout="constrained")
    mesh = random_mesh(60, seed=4)
    for step in (0, 1):
        target = far_reaching(mesh)
        metrics = rtin.propagation(mesh, [target])
        title = f"({'ab'[step]}) t{step}: M1 = {metrics.m1[0]}, M2 = {metrics.m2[0]}"
        draw(axes[step], mesh, roles(mesh, target), title)
        mesh = rtin.refine(mesh, [target])
    draw(axes[2], mesh, np.zeros(mesh.n_triangles), "(c) both refined")
    rtin.plot(along_a_path(), ax=axes[3])
    axes[3].set(title="refined along a path", xticks=[], yticks=[], xlabel="", ylabel="")
    figure.savefig(picture, dpi=90)
    print(f"wrote {picture}")


if __name__ == "__main__":
    main(*sys.argv[1:])
