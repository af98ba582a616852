"""Adaptive finite elements on an L-shaped domain: refine where the error is.

-Δu = f with the solution u = r^(2/3) sin(2θ/3), whose gradient is infinite at the corner that
points inwards. Uniform refinement then converges slowly, however smooth u is elsewhere: the error
in the energy norm falls like N^(-1/3) in the number of unknowns N. The loop

    solve → estimate → mark → refine

brings back N^(-1/2), the best that linear elements can do for any solution. Run

    python examples/l_shape.py [--out FOLDER] [--quick] [--json]

It needs scikit-fem: pip install "rtin[fem]". The estimator is the residual one of Babuška and
Miller (1987), the marking Dörfler's (1996).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
import skfem
from matplotlib import colors
from matplotlib import pyplot as plt
from numpy.typing import NDArray
from skfem.helpers import dot, grad
from skfem.models.poisson import laplace

import rtin

Floats = NDArray[np.float64]
Marking = Callable[[Floats], NDArray[np.bool_]]

BULK = 0.5  # of the squared estimate, marked in each round
ACCURATE = 8  # order of the quadrature for errors and loads


# --- the problem --------------------------------------------------------------------------------


def l_shape() -> rtin.TriangleMesh:
    """Return six right triangles that cover (-1, 1)² without its lower right quarter."""
    x, y = np.array([[-1, -1], [0, -1], [-1, 0], [0, 0], [1, 0], [-1, 1], [0, 1], [1, 1]]).T
    triangles = [[0, 1, 3], [0, 3, 2], [2, 3, 5], [3, 6, 5], [3, 4, 7], [3, 7, 6]]
    return rtin.TriangleMesh.from_triangles(np.column_stack([x, y, 0 * x]), triangles)


def solution(x: Floats) -> Floats:
    """Return u at the places x, shape (2, ...)."""
    angle = np.arctan2(x[1], x[0]) % (2 * np.pi)
    return np.asarray(np.hypot(*x) ** (2 / 3) * np.sin(2 * angle / 3))


def gradient(x: Floats) -> Floats:
    """Return the gradient of u at the places x, shape (2, ...)."""
    angle = np.arctan2(x[1], x[0]) % (2 * np.pi)
    return 2 / 3 * np.hypot(*x) ** (-1 / 3) * np.array([-np.sin(angle / 3), np.cos(angle / 3)])


def source(x: Floats) -> Floats:
    """Return f = -Δu: u is harmonic."""
    return np.zeros_like(x[0])


# --- the loop -----------------------------------------------------------------------------------


class Solved(NamedTuple):
    """What one round found out."""

    n_unknowns: int
    energy_error: float  # |u - u_h| in H1
    l2_error: float
    estimate: float  # of the energy error, but for a constant


def solve(mesh: skfem.MeshTri) -> Floats:
    """Return the values at the vertices of the linear elements' solution."""
    basis = skfem.Basis(mesh, skfem.ElementTriP1())
    load = skfem.LinearForm(lambda v, w: source(w.x) * v)
    boundary = basis.get_dofs()
    values = solution(basis.doflocs)
    system = skfem.condense(laplace.assemble(basis), load.assemble(basis), x=values, D=boundary)
    return np.asarray(skfem.solve(*system))


def estimate(mesh: skfem.MeshTri, u: Floats) -> Floats:
    """Return each triangle's share of the squared residual estimate.

    η² = h² |f + Δu_h|² on the triangle, and h |[∂u_h/∂n]|² on its edges, a half for each of the two
    triangles there. Δu_h is zero for linear elements.
    """
    cells = skfem.Basis(mesh, skfem.ElementTriP1(), intorder=4)
    left, right = (
        skfem.InteriorFacetBasis(mesh, skfem.ElementTriP1(), side=side) for side in (0, 1)
    )
    residual = skfem.Functional(lambda w: w.h**2 * source(w.x) ** 2)
    jump = skfem.Functional(lambda w: w.h * dot(grad(w.left) - grad(w.right), w.n) ** 2)
    on_edges = jump.elemental(left, left=left.interpolate(u), right=right.interpolate(u))
    beside = mesh.f2t[:, left.find]
    from_edges = np.bincount(beside.ravel(), np.tile(on_edges / 2, 2), mesh.nelements)
    return np.asarray(residual.elemental(cells) + from_edges)


def mark_bulk(shares: Floats) -> NDArray[np.bool_]:
    """Return the fewest triangles that hold a given part of the estimate (Dörfler)."""
    order = np.argsort(-shares, kind="stable")
    enough = np.searchsorted(np.cumsum(shares[order]), BULK * shares.sum()) + 1
    marked = np.zeros(len(shares), np.bool_)
    marked[order[:enough]] = True
    return marked


def mark_all(shares: Floats) -> NDArray[np.bool_]:
    """Return all triangles: uniform refinement."""
    return np.ones(len(shares), np.bool_)


def converge(mark: Marking, n_enough: int) -> tuple[list[Solved], list[rtin.TriangleMesh]]:
    """Return the errors and the meshes of the rounds until there are enough unknowns."""
    adaptive = rtin.AdaptiveMesh(l_shape())
    adaptive.refine(mark_all(np.empty(adaptive.n_triangles)))
    rounds, meshes = [], []
    while True:
        mesh = rtin.to_skfem(adaptive.mesh)
        u = solve(mesh)
        shares = estimate(mesh, u)
        rounds.append(measured(mesh, u, shares))
        meshes.append(adaptive.mesh)
        if rounds[-1].n_unknowns >= n_enough:
            return rounds, meshes
        adaptive.refine(mark(shares))


# --- what came out ------------------------------------------------------------------------------


def squared_errors(mesh: skfem.MeshTri, u: Floats) -> tuple[Floats, Floats]:
    """Return the squares of each triangle's error in the energy norm and in L2."""
    basis = skfem.Basis(mesh, skfem.ElementTriP1(), intorder=ACCURATE)
    fields = {"u": basis.interpolate(u)}
    energy = skfem.Functional(lambda w: ((grad(w.u) - gradient(w.x)) ** 2).sum(axis=0))
    l2 = skfem.Functional(lambda w: (w.u - solution(w.x)) ** 2)
    return energy.elemental(basis, **fields), l2.elemental(basis, **fields)


def measured(mesh: skfem.MeshTri, u: Floats, shares: Floats) -> Solved:
    """Return one round's unknowns and errors."""
    energy, l2 = squared_errors(mesh, u)
    n_unknowns = len(mesh.interior_nodes())
    return Solved(n_unknowns, *(float(np.sqrt(part.sum())) for part in (energy, l2, shares)))


def rate(rounds: list[Solved], error: str) -> float:
    """Return r of error ~ N^(-r), fitted to the rounds with a hundred unknowns and more."""
    fitted = [(r.n_unknowns, getattr(r, error)) for r in rounds if r.n_unknowns >= 100]
    n, errors = np.log(np.array(fitted)).T
    return float(-np.polyfit(n, errors, 1)[0])


def error_at(rounds: list[Solved], n_unknowns: int, error: str) -> float:
    """Return an error between the rounds, interpolated on logarithmic scales."""
    n = np.log([r.n_unknowns for r in rounds])
    errors = np.log([getattr(r, error) for r in rounds])
    return float(np.exp(np.interp(np.log(n_unknowns), n, errors)))


def table(runs: dict[str, list[Solved]]) -> str:
    """Return the errors of every run, and the rates, as text."""
    lines = []
    for name, rounds in runs.items():
        lines += [f"{name}", "  unknowns    energy error        L2 error   estimate / error"]
        lines += [
            f"{r.n_unknowns:10d}{r.energy_error:16.3e}{r.l2_error:16.3e}"
            f"{r.estimate / r.energy_error:19.2f}"
            for r in rounds
        ]
        rates = rate(rounds, "energy_error"), rate(rounds, "l2_error")
        lines += ["      rate{:16.2f}{:16.2f}".format(*rates), ""]
    n, energy, l2 = advantage(runs)
    lines += [f"At {n} unknowns uniform errors are {energy:.1f} (L2: {l2:.0f}) times as large."]
    return "\n".join(lines)


def advantage(runs: dict[str, list[Solved]]) -> tuple[int, float, float]:
    """Return a number of unknowns, and how many times as large the uniform errors are there."""
    n = min(rounds[-1].n_unknowns for rounds in runs.values())
    energy, l2 = (
        error_at(runs["uniform"], n, error) / error_at(runs["adaptive"], n, error)
        for error in ("energy_error", "l2_error")
    )
    return n, energy, l2


# --- pictures -----------------------------------------------------------------------------------


def draw(
    runs: dict[str, list[Solved]], meshes: dict[str, list[rtin.TriangleMesh]], path: Path
) -> None:
    """Draw meshes of about a thousand unknowns with their errors, and the convergence."""
    figure, axes = plt.subplots(1, 3, figsize=(14, 4.4), layout="constrained")
    norm = colors.LogNorm(1e-4, 1e-1)
    for name, ax in zip(runs, axes, strict=False):
        chosen = np.argmin([abs(np.log(r.n_unknowns / 800)) for r in runs[name]])
        draw_errors(ax, meshes[name][chosen], norm)
        one = runs[name][chosen]
        ax.set_title(f"{name}: {one.n_unknowns} unknowns, energy error {one.energy_error:.3f}")
    scale = mpl.cm.ScalarMappable(norm, "viridis")
    figure.colorbar(scale, ax=axes[:2], label="energy error of a triangle", shrink=0.9)
    draw_convergence(axes[2], runs)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_errors(ax: plt.Axes, mesh: rtin.TriangleMesh, norm: colors.Normalize) -> None:
    """Draw a mesh, its triangles in the colour of their error."""
    fem = rtin.to_skfem(mesh)
    energy, _ = squared_errors(fem, solve(fem))
    ax.tripcolor(
        rtin.to_triangulation(mesh), np.sqrt(energy), norm=norm, edgecolors="white", linewidth=0.15
    )
    ax.set(aspect="equal", xticks=[-1, 0, 1], yticks=[-1, 0, 1])


def draw_convergence(ax: plt.Axes, runs: dict[str, list[Solved]]) -> None:
    """Draw errors over unknowns, both logarithmic, with the rates of theory beside them."""
    styles = {"uniform": ("C1", "s", 3), "adaptive": ("C0", "o", 2)}
    labels = {"energy_error": "energy", "l2_error": "L2"}
    for name, rounds in runs.items():
        colour, marker, power = styles[name]
        n = np.array([r.n_unknowns for r in rounds])
        for error, label in labels.items():
            errors = np.array([getattr(r, error) for r in rounds])
            filled = colour if error == "energy_error" else "white"
            measured_rate = f"{name}, {label}: N^-{rate(rounds, error):.2f}"
            ax.loglog(n, errors, colour, marker=marker, ms=4, mfc=filled, label=measured_rate)
            slope = -(1 if error == "energy_error" else 2) / power
            ax.loglog(n[-4:], 1.5 * errors[-1] * (n[-4:] / n[-1]) ** slope, "k:", lw=1)
    ax.set(xlabel="unknowns N", ylabel="error", title="dotted: the rates of theory")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


def main() -> None:
    """Run both ways of refining, and say what came out."""
    parser = argparse.ArgumentParser(description="Adaptive finite elements on an L-shaped domain.")
    parser.add_argument("--out", type=Path, default=Path("demo/fem"), help="folder of the picture")
    parser.add_argument("--quick", action="store_true", help="stop at 3000 unknowns")
    parser.add_argument("--json", action="store_true", help="print the results for programs")
    given = parser.parse_args()

    mpl.use("Agg")
    ways: dict[str, Marking] = {"uniform": mark_all, "adaptive": mark_bulk}
    runs, meshes = {}, {}
    for name, mark in ways.items():
        runs[name], meshes[name] = converge(mark, 3_000 if given.quick else 100_000)
    given.out.mkdir(parents=True, exist_ok=True)
    draw(runs, meshes, given.out / "l_shape.png")
    if given.json:
        print(json.dumps({name: [r._asdict() for r in rounds] for name, rounds in runs.items()}))
    else:
        print(table(runs))
        print(f"The picture is {given.out / 'l_shape.png'}.")


if __name__ == "__main__":
    main()
