"""A mesh that follows a moving source: contaminant transport in two dimensions.

A leaking ship crosses a harbour with two eddies. The concentration u obeys

    ∂u/∂t + ∇·(b u) - κ Δu + λ u = f,    no flux through the walls,

and what settles, λ u, stays on the ground where it fell. Fine triangles are needed at the ship and
along the plume, and both move. So every few time steps the mesh goes through

    estimate → mark → refine → coarsen → transfer

and the solution is compared with those on meshes that stay: one with the same smallest triangles
everywhere, and one of as many unknowns. Run

    python examples/moving_source.py [--out FOLDER] [--quick] [--json]

It needs scikit-fem: pip install "rtin[fem]". Linear elements, and Crank and Nicolson's time steps.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
import skfem
from matplotlib import animation, colors
from matplotlib import pyplot as plt
from matplotlib.tri import LinearTriInterpolator, Triangulation
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import SuperLU, splu
from skfem.helpers import dot, grad
from skfem.models.poisson import laplace, mass

import rtin

Floats = NDArray[np.float64]

DIFFUSION = 5e-4  # κ
SETTLING = 0.5  # λ, a share per unit of time
RADIUS = 0.02  # of the source: the standard deviation of its bell
TIME_STEP = 0.01
EVERY = 4  # time steps between two changes of the mesh
COARSEST = 8  # squares along a side of the coarsest mesh, of two triangles each
MUCH = 2e-4  # estimated L2 error of a triangle that is refined
LITTLE = MUCH / 16  # and of one that may be coarsened: merged, it is still far from being split


# --- the problem --------------------------------------------------------------------------------


def flow(x: Floats) -> Floats:
    """Return the velocity b of two eddies: free of divergence, along the walls of the square."""
    return np.array(
        [
            np.sin(2 * np.pi * x[0]) * np.cos(np.pi * x[1]) / 2,
            -np.cos(2 * np.pi * x[0]) * np.sin(np.pi * x[1]),
        ]
    )


def ship(time: float) -> Floats:
    """Return where the ship is."""
    return np.array([0.15 + 0.7 * time, 0.5 + 0.25 * np.sin(2 * np.pi * time)])


def release(x: Floats, time: float) -> Floats:
    """Return f: one unit of mass per unit of time."""
    squared = ((x - ship(time)[:, np.newaxis]) ** 2).sum(axis=0)
    return np.asarray(np.exp(-squared / (2 * RADIUS**2)) / (2 * np.pi * RADIUS**2))


# --- solve --------------------------------------------------------------------------------------


class Discrete(NamedTuple):
    """What the time steps on one mesh have in common."""

    basis: skfem.Basis
    mass: csr_matrix
    before: csr_matrix  # applied to the solution before the step
    after: SuperLU  # and solved for the one after it


def discretise(basis: skfem.Basis) -> Discrete:
    """Return the matrices of Crank and Nicolson's method, and the factors of the one to solve."""
    # With v = 1 this vanishes whatever the quadrature: nothing is lost to the flow.
    advection = skfem.BilinearForm(lambda u, v, w: -u * dot(flow(w.x), grad(v)))
    inertia = mass.assemble(basis)
    change = advection.assemble(basis) + DIFFUSION * laplace.assemble(basis) + SETTLING * inertia
    after = (inertia / TIME_STEP + change / 2).tocsc()
    return Discrete(basis, inertia, inertia / TIME_STEP - change / 2, splu(after))


def advance(discrete: Discrete, u: Floats, time: float) -> Floats:
    """Return the solution one time step later."""
    load = discrete.mass @ release(discrete.basis.doflocs, time + TIME_STEP / 2)
    return np.asarray(discrete.after.solve(discrete.before @ u + load))


# --- estimate, mark, refine, coarsen, transfer --------------------------------------------------


class Fields(NamedTuple):
    """What lives on the mesh."""

    u: Floats  # at the vertices
    settled: Floats  # mass per area, in the triangles


def estimate(mesh: skfem.MeshTri, u: Floats) -> Floats:
    """Return how curved u is in each triangle: second derivatives, from the jumps of the first.

    An L2 error is about curvature times area^(3/2). The curvature stays when a triangle is split.
    """
    left, right = (
        skfem.InteriorFacetBasis(mesh, skfem.ElementTriP1(), intorder=1, side=side)
        for side in (0, 1)
    )
    jump = skfem.Functional(lambda w: dot(grad(w.left) - grad(w.right), w.n) ** 2 / w.h**3)
    on_edges = jump.elemental(left, left=left.interpolate(u), right=right.interpolate(u))
    beside = mesh.f2t[:, left.find]
    from_edges = np.bincount(beside.ravel(), np.tile(on_edges / 2, 2), mesh.nelements)
    return np.asarray(np.sqrt(from_edges))


def at_the_ship(mesh: rtin.TriangleMesh, areas: Floats, time: float) -> NDArray[np.bool_]:
    """Return which triangles the source reaches before the mesh changes again."""
    centres = mesh.vertices[mesh.triangles, :2].mean(axis=1)
    places = [ship(time + share * EVERY * TIME_STEP) for share in (0.0, 0.5, 1.0)]
    distances = np.min([np.linalg.norm(centres - place, axis=1) for place in places], axis=0)
    return np.asarray(distances < 3 * RADIUS + np.sqrt(areas))


def transfer(adaptive: rtin.AdaptiveMesh, fields: Fields) -> Fields:
    """Return the fields on the mesh after its last change."""
    settled = adaptive.transfer(fields.settled, on="triangles")
    return Fields(adaptive.transfer(fields.u), settled)


def adapt(
    adaptive: rtin.AdaptiveMesh, fields: Fields, curvature: Floats, time: float, finest: int
) -> Fields:
    """Refine the mesh where u is off by much, coarsen it where by little; return the fields."""
    while True:
        areas = adaptive.mesh.signed_areas()
        errors, source = curvature * areas**1.5, at_the_ship(adaptive.mesh, areas, time)
        targets = ((errors > MUCH) | source) & (adaptive.levels < finest)
        if not targets.any():
            break
        adaptive.refine(targets, "bisection")
        fields = transfer(adaptive, fields)
        curvature = adaptive.transfer(curvature, on="triangles")
    adaptive.coarsen((errors < LITTLE) & ~source)
    return transfer(adaptive, fields)


# --- runs ---------------------------------------------------------------------------------------


class Moment(NamedTuple):
    """The state after a time step."""

    time: float
    mesh: rtin.TriangleMesh
    fields: Fields
    drift: float  # of the settled mass in the transfers of this step, relative


class Clock(dict[str, float]):
    """Seconds spent in each part of a run."""

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Add the seconds of a with block to a part."""
        start = perf_counter()
        yield
        self[part] = self.get(part, 0.0) + perf_counter() - start


def square() -> rtin.TriangleMesh:
    """Return the coarsest mesh of the unit square."""
    side = np.linspace(0, 1, COARSEST + 1)
    return rtin.from_skfem(skfem.MeshTri.init_tensor(side, side))


def uniform(n: int, element: skfem.Element) -> skfem.Basis:
    """Return the elements on n × n squares of two triangles."""
    side = np.linspace(0, 1, n + 1)
    return skfem.Basis(skfem.MeshTri.init_tensor(side, side), element)


def masses(mesh: rtin.TriangleMesh, fields: Fields) -> tuple[float, float]:
    """Return the mass in the water and the mass that has settled."""
    areas = mesh.signed_areas()
    in_water = areas @ fields.u[mesh.triangles].mean(axis=1)
    return float(in_water), float(areas @ fields.settled)


def follow(n_steps: int, finest: int, clock: Clock) -> Iterator[Moment]:
    """Yield the states of a mesh that follows the ship, with triangles up to a level."""
    adaptive = rtin.AdaptiveMesh(square())
    fields = Fields(np.zeros(adaptive.n_vertices), np.zeros(adaptive.n_triangles))
    fem = rtin.to_skfem(adaptive.mesh)
    for step in range(n_steps):
        time, drift = step * TIME_STEP, 0.0
        if step % EVERY == 0:
            _, settled = masses(adaptive.mesh, fields)
            with clock("estimate"):
                curvature = estimate(fem, fields.u)
            with clock("mesh"):
                fields = adapt(adaptive, fields, curvature, time, finest)
            if settled:
                drift = masses(adaptive.mesh, fields)[1] / settled - 1.0
            fem = rtin.to_skfem(adaptive.mesh)
            with clock("matrix"):
                discrete = discretise(skfem.Basis(fem, skfem.ElementTriP1()))
        with clock("step"):
            u = advance(discrete, fields.u, time)
        between = (fields.u + u)[adaptive.mesh.triangles].mean(axis=1) / 2
        fields = Fields(u, fields.settled + TIME_STEP * SETTLING * between)
        yield Moment(time + TIME_STEP, adaptive.mesh, fields, drift)


def stay(basis: skfem.Basis, n_steps: int, clock: Clock) -> Floats:
    """Return the solution at the end, on a mesh that stays: its matrix is factorised once."""
    with clock("matrix"):
        discrete = discretise(basis)
    u = np.zeros(basis.N)
    with clock("step"):
        for step in range(n_steps):
            u = advance(discrete, u, step * TIME_STEP)
    return u


# --- what came out ------------------------------------------------------------------------------


class Run(NamedTuple):
    """What a way of meshing took, and how good it was."""

    unknowns: float  # the mean over time
    error: float  # in L2 at the end, beside the reference; relative
    seconds: float
    seconds_of_a_matrix: float  # to assemble and factorise one
    undershoot: float  # the least u, as a share of the largest one


class Reference:
    """The solution by quadratic elements on the smallest triangles, to measure others by."""

    def __init__(self, n: int, n_steps: int) -> None:
        self.n_steps = n_steps
        self.basis = uniform(n, skfem.ElementTriP2())
        self.u = stay(self.basis, n_steps, Clock())
        self.mass = mass.assemble(self.basis)

    def norm(self, u: Floats) -> float:
        """Return the L2 norm."""
        return float(np.sqrt(u @ (self.mass @ u)))

    def error(self, mesh: skfem.MeshTri, u: Floats) -> float:
        """Return how far a solution by linear elements is off, in L2; relative."""
        interpolated = LinearTriInterpolator(Triangulation(*mesh.p, mesh.t.T), u)
        return self.norm(interpolated(*self.basis.doflocs) - self.u) / self.norm(self.u)

    def compare(self, n: int) -> Run:
        """Return the run on n × n squares that stay."""
        basis, clock = uniform(n, skfem.ElementTriP1()), Clock()
        u = stay(basis, self.n_steps, clock)
        return Run(
            unknowns=float(basis.N),
            error=self.error(basis.mesh, u),
            seconds=sum(clock.values()),
            seconds_of_a_matrix=clock["matrix"],
            undershoot=float(u.min() / u.max()),
        )


def summary(moments: list[Moment], clock: Clock, reference: Reference) -> Run:
    """Return the run on the mesh that follows."""
    n_matrices = len(range(0, len(moments), EVERY))
    u = moments[-1].fields.u
    return Run(
        unknowns=float(np.mean([moment.mesh.n_vertices for moment in moments])),
        error=reference.error(rtin.to_skfem(moments[-1].mesh), u),
        seconds=sum(clock.values()),
        seconds_of_a_matrix=clock["matrix"] / n_matrices,
        undershoot=float(u.min() / u.max()),
    )


class Balance(NamedTuple):
    """Where the mass is that the ship has released, one unit per unit of time."""

    released: float
    in_water: float
    settled: float
    gained: float  # where the mesh is coarsened and u is interpolated
    drift: float  # of the settled mass in one change of the mesh, relative, at most


def balance(moments: list[Moment]) -> Balance:
    """Return the balance at the end."""
    last = moments[-1]
    in_water, settled = masses(last.mesh, last.fields)
    drift = max(abs(moment.drift) for moment in moments)
    return Balance(last.time, in_water, settled, in_water + settled - last.time, drift)


def table(runs: dict[str, Run], kept: Balance, clock: Clock) -> str:
    """Return the results as text."""
    lines = [f"{'mesh':24}unknowns    L2 error    least u    seconds    a matrix"]
    lines += [
        f"{name:24}{run.unknowns:8.0f}{run.error:12.2%}{run.undershoot:11.2%}"
        f"{run.seconds:9.1f} s{run.seconds_of_a_matrix:10.3f} s"
        for name, run in runs.items()
    ]
    parts = ", ".join(f"{part} {seconds:.1f}" for part, seconds in clock.items())
    lines += [
        "",
        f"Seconds of the mesh that follows: {parts}.",
        f"Released {kept.released:.4f}, in the water {kept.in_water:.4f}, settled "
        f"{kept.settled:.4f}: coarsening has added {kept.gained:.1e}.",
        f"Changes of the mesh change the settled mass by {kept.drift:.0e} of it at most.",
    ]
    return "\n".join(lines)


# --- pictures -----------------------------------------------------------------------------------

SHADES = mpl.cm.ScalarMappable(colors.PowerNorm(0.5, 0.0, 10.0, clip=True), "YlGnBu")


def draw_concentration(ax: plt.Axes, moment: Moment, width: float) -> None:
    """Draw the concentration, the mesh over it in lines of a width, and the ship."""
    seen = rtin.to_triangulation(moment.mesh)
    ax.tripcolor(seen, moment.fields.u, norm=SHADES.norm, cmap=SHADES.cmap, shading="gouraud")
    ax.triplot(seen, color="black", linewidth=width, alpha=0.5)
    ax.plot(*ship(moment.time), "o", mfc="white", mec="black", ms=6)
    frame_square(ax)


def frame_square(ax: plt.Axes) -> None:
    """Show the unit square, and nothing else."""
    ax.set(aspect="equal", xlim=(0, 1), ylim=(0, 1), xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])


def draw(moments: list[Moment], n_uniform: int, path: Path) -> None:
    """Draw the end: the concentration over the mesh, what has settled, and the unknowns."""
    figure, axes = plt.subplots(1, 3, figsize=(14, 4.3), layout="constrained")
    last = moments[-1]
    draw_concentration(axes[0], last, 0.12)
    axes[0].set_title(f"{last.mesh.n_vertices} unknowns at the end")
    figure.colorbar(SHADES, ax=axes[0], label="concentration", extend="max")
    settled = axes[1].tripcolor(
        rtin.to_triangulation(last.mesh),
        last.fields.settled,
        cmap="YlOrBr",
        norm=colors.PowerNorm(0.5),
    )
    frame_square(axes[1])
    axes[1].set_title("on the ground")
    figure.colorbar(settled, ax=axes[1], label="settled mass per area")
    times = [moment.time for moment in moments]
    axes[2].semilogy(times, [moment.mesh.n_vertices for moment in moments], label="follows")
    axes[2].axhline(n_uniform, color="C1", label="stays, the same smallest triangles")
    axes[2].set(xlabel="time", ylabel="unknowns", ylim=(100, 3 * n_uniform))
    axes[2].grid(alpha=0.3)
    axes[2].legend(loc="lower right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def animate(moments: list[Moment], path: Path) -> None:
    """Write an animation of the concentration over the mesh."""
    figure, ax = plt.subplots(figsize=(7, 6), layout="constrained")
    figure.colorbar(SHADES, ax=ax, label="concentration", extend="max")

    def frame(moment: Moment) -> None:
        ax.clear()
        draw_concentration(ax, moment, 0.15)
        ax.set_title(f"time {moment.time:.2f}, {moment.mesh.n_vertices} unknowns")

    film = animation.FuncAnimation(figure, frame, moments, init_func=lambda: None)
    film.save(path, animation.PillowWriter(fps=6), dpi=90)
    plt.close(figure)


def main() -> None:
    """Run on the mesh that follows and on those that stay, and say what came out."""
    parser = argparse.ArgumentParser(description="A mesh that follows a moving source.")
    parser.add_argument("--out", type=Path, default=Path("demo/fem"), help="folder of the pictures")
    parser.add_argument("--quick", action="store_true", help="half the resolution, fewer steps")
    parser.add_argument("--json", action="store_true", help="print the results for programs")
    given = parser.parse_args()

    mpl.use("Agg")
    n_steps, finest = (60, 8) if given.quick else (100, 10)
    n = COARSEST * 2 ** (finest // 2)
    reference = Reference(n, n_steps)
    clock = Clock()
    moments = list(follow(n_steps, finest, clock))
    follows = summary(moments, clock, reference)
    runs = {
        "follows the ship": follows,
        "stays, as many unknowns": reference.compare(round(np.sqrt(follows.unknowns)) - 1),
        "stays, as small": reference.compare(n),
    }
    kept = balance(moments)
    given.out.mkdir(parents=True, exist_ok=True)
    draw(moments, (n + 1) ** 2, given.out / "moving_source.png")
    animate(moments[EVERY - 1 :: EVERY], given.out / "moving_source.gif")
    if given.json:
        print(
            json.dumps(
                {
                    "runs": {name: run._asdict() for name, run in runs.items()},
                    "mass": kept._asdict(),
                }
            )
        )
    else:
        print(table(runs, kept, clock))
        print(f"The pictures are moving_source.png and moving_source.gif in {given.out}.")


if __name__ == "__main__":
    main()
