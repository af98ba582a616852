"""How far refining one triangle propagates: section 2.1.2 and figure 3 of the paper, and beyond.

Suárez and Plaza, "Four-triangles adaptive algorithms for RTIN terrain meshes", refine a uniform
mesh of 128 triangles 300 times at random and report that the means of M1 and M2 over its triangles
grow from 5 and 2 to 7.3 and 3.8. Here that is done over many seeds, then carried on to a million
refinements, repeated on Delaunay meshes, and set beside the worst cases.

Triangles to refine are drawn uniformly from the mesh as it is at that moment; a mean is over all
triangles of it; a spread is the standard deviation of such means over the seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin._adjacency import twins_of
from rtin.adaptive import AdaptiveMesh
from rtin.conformity import Propagation, propagation
from rtin.mesh import TriangleMesh
from rtin.refinement import refine

__all__ = [
    "PAPER",
    "PLACES",
    "Evolution",
    "LongRuns",
    "Row",
    "Study",
    "WorstCase",
    "as_text",
    "evolution",
    "growing_strip",
    "measure",
    "propagation_means",
    "random_refinements",
    "random_tin",
    "refine_at",
    "rows",
    "touched_by",
    "uniform_mesh",
]

_Floats = NDArray[np.float64]
_Counts = NDArray[np.int64]
MeshOfSeed = Callable[[int], TriangleMesh]
Stage = Callable[[str], AbstractContextManager[None]]


class Means(NamedTuple):
    """Means of M1 and M2."""

    m1: float
    m2: float


PAPER = {"uniform": Means(5.0, 2.0), "refined": Means(7.3, 3.8), "any mesh": Means(7.2, 3.6)}

# Places of the unit square to refine at again and again.
PLACES = {"corner": (0.0, 0.0), "border": (0.5, 0.0), "centre": (0.5, 0.5)}

_SMALL_TIN = 10_000  # points
_LONG_TINS = {100: 200, 1000: 50, 10_000: 20, 100_000: 10, 1_000_000: 3}  # points: seeds
_LONG_CHECKPOINTS = (1, 3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000, 100_000)
_LONG_SEEDS, _LONGEST, _LONGEST_SEEDS = 20, 1_000_000, 3
_REFINED_TIN, _INSIDE_OF = 1000, 100_000  # points
_N_SEEN = 30  # times that each of many runs is looked at


# --- meshes -------------------------------------------------------------------------------------


def uniform_mesh(levels: int = 3) -> TriangleMesh:
    """Return the unit square in 2 · 4**levels right isosceles triangles, 128 by default.

    Two triangles, each split into four ``levels`` times: diagonals alternate, as on any RTIN.
    """
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
    mesh = TriangleMesh(corners, [[2, 0, 1], [0, 2, 3]])
    for _ in range(levels):
        mesh = refine(mesh, np.ones(mesh.n_triangles, np.bool_))
    return mesh


def random_tin(n_points: int, seed: int) -> TriangleMesh:
    """Return the Delaunay triangles of points drawn uniformly from the unit square."""
    from matplotlib.tri import Triangulation

    points = np.random.default_rng(seed).random((n_points, 2))
    triangles = Triangulation(points[:, 0], points[:, 1]).triangles
    return TriangleMesh.from_triangles(np.column_stack([points, np.zeros(n_points)]), triangles)


def growing_strip(n_triangles: int) -> TriangleMesh:
    r"""Return a strip in which every triangle shares its longest edge with the next, longer one.

    ::

          1---3----5-----7     triangle i: points i, i+1, i+2
         / \ / \  / \   /      longest edge: from i+1 to i+2
        0---2----4-----6

    Edges grow by some hundredths from one end to the other. Refining triangle 0 splits them all.
    """
    steps = 1.0 + np.arange(n_triangles + 1) / max(1, n_triangles)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    across = np.where(np.arange(n_triangles + 2) % 2 == 0, 0.0, 5.0)
    first = np.arange(n_triangles)
    triangles = np.column_stack([first, first + 1, first + 2])
    return TriangleMesh.from_triangles(np.column_stack([along, across, 0.0 * along]), triangles)


# --- steps --------------------------------------------------------------------------------------


def random_refinements(
    mesh: TriangleMesh, checkpoints: Sequence[int], rng: np.random.Generator
) -> Iterator[TriangleMesh]:
    """Yield the mesh after each of so many 4T-LE refinements of one triangle drawn at random.

    Parameters
    ----------
    mesh : TriangleMesh
    checkpoints : sequence of int
        Ascending: after how many refinements.
    rng : numpy.random.Generator
        Draws each triangle uniformly from the mesh as it is then.
    """
    adaptive, done = AdaptiveMesh(mesh), 0
    for checkpoint in checkpoints:
        for _ in range(checkpoint - done):
            adaptive.refine([int(rng.integers(adaptive.n_triangles))])
        done = checkpoint
        yield adaptive.mesh


def propagation_means(found: Propagation) -> Means:
    """Return the means of M1 and M2."""
    return Means(float(found.m1.mean()), float(found.m2.mean()))


def touched_by(mesh: TriangleMesh, triangle: int) -> NDArray[np.int64]:
    """Return the triangles that refining one of them splits, itself included, ascending."""
    numbered = TriangleMesh(mesh.vertices, mesh.triangles, tags=np.arange(mesh.n_triangles))
    tags = refine(numbered, [triangle]).tags
    assert tags is not None
    return np.flatnonzero(np.bincount(tags) > 1)


def _triangles_at(mesh: TriangleMesh, place: tuple[float, float]) -> NDArray[np.int64]:
    """Return the triangles that contain a place, borders included, the smallest first."""
    corners = mesh.vertices[mesh.triangles, :2]
    along, to = np.roll(corners, -1, axis=1) - corners, np.asarray(place) - corners
    turns = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
    there = np.flatnonzero((turns >= 0.0).all(axis=1))
    return there[np.argsort(mesh.signed_areas()[there], kind="stable")]


# --- experiments --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Evolution:
    """Means of M1 and M2 while meshes are refined at random, a row for each seed.

    Attributes
    ----------
    splits : ndarray of int64, shape (k,)
        After how many refinements.
    m1, m2 : ndarray of float64, shape (n_seeds, k)
        Means over all triangles.
    n_triangles : ndarray of int64, shape (n_seeds, k)
    m1_counts, m2_counts : ndarray of int64
        How many triangles of the last meshes, of all seeds together, have M1 or M2 = 0, 1, 2, ….
    mesh : TriangleMesh
        The last one of the first seed.
    """

    splits: _Counts
    m1: _Floats
    m2: _Floats
    n_triangles: _Counts
    m1_counts: _Counts
    m2_counts: _Counts
    mesh: TriangleMesh

    @property
    def last(self) -> tuple[Means, Means]:
        """Mean and spread over the seeds in the end; the spread is NaN for one seed."""
        return _mean_and_spread(np.column_stack([self.m1[:, -1], self.m2[:, -1]]))


def evolution(initial: MeshOfSeed, checkpoints: ArrayLike, seeds: ArrayLike) -> Evolution:
    """Return how the means of M1 and M2 evolve, over seeds.

    Parameters
    ----------
    initial : callable
        Gives the mesh to start from, for a seed.
    checkpoints : array_like of int
        Ascending: after how many refinements to take the means.
    seeds : array_like of int
        At least one. The same seed gives the same run.
    """
    splits, numbers = np.asarray(checkpoints, np.int64), np.asarray(seeds, np.int64)
    m1, m2 = np.empty((2, len(numbers), len(splits)))
    n_triangles = np.empty(m1.shape, np.int64)
    m1_counts = m2_counts = np.zeros(0, np.int64)
    first: TriangleMesh | None = None
    for row, seed in enumerate(numbers.tolist()):
        rng = np.random.default_rng(seed)
        for i, mesh in enumerate(random_refinements(initial(seed), splits.tolist(), rng)):
            found = propagation(mesh)
            m1[row, i], m2[row, i] = propagation_means(found)
            n_triangles[row, i] = mesh.n_triangles
        m1_counts = _added(m1_counts, np.bincount(found.m1))
        m2_counts = _added(m2_counts, np.bincount(found.m2))
        first = first or mesh
    if first is None:
        raise ValueError("at least one seed is wanted, got none")
    return Evolution(splits, m1, m2, n_triangles, m1_counts, m2_counts, first)


@dataclass(frozen=True, eq=False)
class WorstCase:
    """Refining the smallest triangle at a place again and again, a value for each step.

    Attributes
    ----------
    largest_m2 : ndarray of int64
        The largest M2 in the mesh, before the step.
    target_m1, target_m2 : ndarray of int64
        Of the triangle that is refined.
    mesh : TriangleMesh
        The one before the last step.
    """

    largest_m2: _Counts
    target_m1: _Counts
    target_m2: _Counts
    mesh: TriangleMesh


def refine_at(place: tuple[float, float], n_steps: int, levels: int = 3) -> WorstCase:
    """Return what refining a uniform mesh again and again at one place of it leads to."""
    adaptive = AdaptiveMesh(uniform_mesh(levels))
    steps = np.empty((n_steps, 3), np.int64)
    for step in range(n_steps):
        mesh = adaptive.mesh
        target = int(_triangles_at(mesh, place)[0])
        m1, m2 = propagation(mesh)
        steps[step] = m2.max(), m1[target], m2[target]
        adaptive.refine([target])
    largest_m2, target_m1, target_m2 = steps.T
    return WorstCase(largest_m2, target_m1, target_m2, mesh)


@dataclass(frozen=True, eq=False)
class LongRuns:
    """What takes minutes: each an ``Evolution``.

    Attributes
    ----------
    rtin, longest : Evolution
        The uniform mesh, refined 10⁵ times over 20 seeds, and 10⁶ times over 3.
    tin : Evolution
        Delaunay meshes of 1000 points, refined 10⁵ times.
    tins : dict of int to Evolution
        Delaunay meshes of so many points, not refined.
    tins_inside : ndarray of float64, shape (n_seeds, 2)
        Means of M1 and M2 of those of 10⁵ points, without the triangles near the border.
    uniform_tin : list of Means
        A Delaunay mesh of 10⁴ points after 0, 1, 2, … refinements of all its triangles.
    """

    rtin: Evolution
    longest: Evolution
    tin: Evolution
    tins: dict[int, Evolution]
    tins_inside: _Floats
    uniform_tin: list[Means]


@dataclass(frozen=True, eq=False)
class Study:
    """All that is measured.

    Attributes
    ----------
    uniform, uniform_inside : Means
        Of the mesh to start from: over all triangles, and over those without a border side.
    runs : Evolution
        The experiment of figure 3, over the seeds.
    one_run : Evolution
        The first seed's run, looked at after every refinement if there are at most 1000.
    tins : Evolution
        Delaunay meshes of 10 000 points, not refined.
    worst : dict of str to WorstCase
        For each of ``PLACES``.
    strip : Propagation
        Of the first triangle of a ``growing_strip`` of 1000.
    long : LongRuns or None
    """

    uniform: Means
    uniform_inside: Means
    runs: Evolution
    one_run: Evolution
    tins: Evolution
    worst: dict[str, WorstCase]
    strip: Propagation
    long: LongRuns | None


def measure(
    n_seeds: int = 200, n_splits: int = 300, *, long: bool = False, stage: Stage | None = None
) -> Study:
    """Return all measurements.

    Parameters
    ----------
    n_seeds, n_splits : int
        Runs of the experiment of figure 3, and refinements in each.
    long : bool
        Go on to 10⁶ refinements and Delaunay meshes of 10⁶ points, which takes minutes.
    stage : callable, optional
        Gets the name of what begins, and returns a context in which it is done.

    Raises
    ------
    ValueError
        If a number is less than one.
    """
    for name, number in [("n_seeds", n_seeds), ("n_splits", n_splits)]:
        if number < 1:
            raise ValueError(f"{name} must be one or more, got {number}")
    stage = stage or (lambda _: nullcontext())
    uniform = uniform_mesh()
    with stage(f"refining {n_splits} times at random, {n_seeds} seeds"):
        start: MeshOfSeed = lambda _: uniform  # noqa: E731
        runs = evolution(start, _spaced(n_splits, _N_SEEN), np.arange(n_seeds))
        one_run = evolution(start, _spaced(n_splits, 1000), [0])
    with stage("measuring Delaunay meshes"):
        tins = evolution(partial(random_tin, _SMALL_TIN), [0], np.arange(min(n_seeds, 10)))
    with stage("refining again and again at one place"):
        worst = {name: refine_at(place, 16) for name, place in PLACES.items()}
    found = propagation(uniform)
    inside = (twins_of(uniform).reshape(-1, 3) >= 0).all(axis=1)
    return Study(
        uniform=propagation_means(found),
        uniform_inside=propagation_means(Propagation(found.m1[inside], found.m2[inside])),
        runs=runs,
        one_run=one_run,
        tins=tins,
        worst=worst,
        strip=propagation(growing_strip(1000), [0]),
        long=_long_runs(stage) if long else None,
    )


def _long_runs(stage: Stage) -> LongRuns:
    uniform = uniform_mesh()
    with stage(f"refining 100 000 times at random, {_LONG_SEEDS} seeds"):
        rtin = evolution(lambda _: uniform, _LONG_CHECKPOINTS, np.arange(_LONG_SEEDS))
    with stage(f"refining a million times at random, {_LONGEST_SEEDS} seeds"):
        checkpoints = [*_LONG_CHECKPOINTS[-2:], _LONGEST]
        longest = evolution(lambda _: uniform, checkpoints, np.arange(_LONGEST_SEEDS))
    with stage("refining Delaunay meshes 100 000 times at random"):
        small = partial(random_tin, _REFINED_TIN)
        tin = evolution(small, [0, *_LONG_CHECKPOINTS], np.arange(_LONG_SEEDS // 2))
    tins = {}
    for n_points, n_seeds in _LONG_TINS.items():
        with stage(f"measuring Delaunay meshes of {n_points} points"):
            tins[n_points] = evolution(partial(random_tin, n_points), [0], np.arange(n_seeds))
    with stage("measuring Delaunay meshes away from their border"):
        seeds = range(_LONG_TINS[_INSIDE_OF])
        inside = np.array([_means_inside(random_tin(_INSIDE_OF, seed)) for seed in seeds])
    with stage("refining all triangles of a Delaunay mesh"):
        uniform_tin = _refined_uniformly(random_tin(_SMALL_TIN, 0), 5)
    return LongRuns(rtin, longest, tin, tins, inside, uniform_tin)


def _means_inside(mesh: TriangleMesh) -> Means:
    """Return the means over the triangles whose centres lie in the middle 80 % of both sides."""
    centres = mesh.vertices[mesh.triangles, :2].mean(axis=1)
    return propagation_means(propagation(mesh, (np.abs(centres - 0.5) < 0.4).all(axis=1)))


def _refined_uniformly(mesh: TriangleMesh, n_times: int) -> list[Means]:
    means = [propagation_means(propagation(mesh))]
    for _ in range(n_times):
        mesh = refine(mesh, np.ones(mesh.n_triangles, np.bool_))
        means.append(propagation_means(propagation(mesh)))
    return means


def _spaced(n_splits: int, n_most: int) -> _Counts:
    """Return 0 to ``n_splits`` in at most so many steps."""
    return np.linspace(0, n_splits, min(n_splits, n_most) + 1).round().astype(np.int64)


def _mean_and_spread(values: _Floats) -> tuple[Means, Means]:
    """Return the mean and the standard deviation of each of the two columns."""
    spread = values.std(axis=0, ddof=1) if len(values) > 1 else np.full(2, np.nan)
    return Means(*values.mean(axis=0).tolist()), Means(*spread.tolist())


def _added(one: _Counts, other: _Counts) -> _Counts:
    total = np.zeros(max(len(one), len(other)), np.int64)
    total[: len(one)] += one
    total[: len(other)] += other
    return total


# --- tables -------------------------------------------------------------------------------------


class Row(NamedTuple):
    """A figure of the paper, if it has one, and ours."""

    quantity: str
    paper: float | None
    ours: float
    spread: float | None


def rows(study: Study) -> list[Row]:
    """Return the figures of a study, one a row."""
    n_splits = int(study.runs.splits[-1])
    none = Means(np.nan, np.nan)
    uniform = f"uniform mesh of {study.runs.n_triangles[0, 0]} triangles"
    table = [
        *_pair(uniform, None, study.uniform, none),
        *_pair(f"{uniform}, off the border", PAPER["uniform"], study.uniform_inside, none),
        *_pair(
            f"after {_number(n_splits)} splits, {_seeds(study.runs)}",
            PAPER["refined"],
            *study.runs.last,
        ),
    ]
    if study.long is None:
        return [*table, *_rows_of_tins({_SMALL_TIN: study.tins})]
    for run, at in [(study.long.rtin, 1000), (study.long.rtin, 10_000), (study.long.rtin, 100_000),
                    (study.long.longest, _LONGEST)]:  # fmt: skip
        table += _pair(f"after {_number(at)} splits, {_seeds(run)}", None, *_at(run, at))
    table += _rows_of_tins(study.long.tins)
    name = f"Delaunay mesh of {_number(_INSIDE_OF)} points, away from the border"
    table += _pair(name, None, *_mean_and_spread(study.long.tins_inside))
    name = f"Delaunay mesh of {_number(_REFINED_TIN)} points"
    for at in (1000, 10_000, 100_000):
        table += _pair(f"{name}, after {_number(at)} splits", None, *_at(study.long.tin, at))
    name = f"Delaunay mesh of {_number(_SMALL_TIN)} points"
    for times, means in enumerate(study.long.uniform_tin):
        table += _pair(f"{name}, uniformly refined {times} ×", None, means, none)
    return table


def _rows_of_tins(tins: dict[int, Evolution]) -> list[Row]:
    table = []
    for n_points, run in tins.items():
        name = f"Delaunay mesh of {_number(n_points)} points, {_seeds(run)}"
        table += _pair(name, PAPER["any mesh"], *run.last)
    return table


def _at(run: Evolution, n_splits: int) -> tuple[Means, Means]:
    i = int(np.flatnonzero(run.splits == n_splits)[0])
    return _mean_and_spread(np.column_stack([run.m1[:, i], run.m2[:, i]]))


def _pair(name: str, paper: Means | None, ours: Means, spread: Means) -> list[Row]:
    return [
        Row(f"{letter}, {name}", None if paper is None else paper[i], ours[i], _or_none(spread[i]))
        for i, letter in enumerate(("M1", "M2"))
    ]


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else value


def _seeds(run: Evolution) -> str:
    return f"{len(run.m1)} seed{'s' if len(run.m1) > 1 else ''}"


def _number(value: int) -> str:
    return f"{value:,}".replace(",", " ")


def as_text(table: Sequence[Row]) -> str:
    """Return the table for people, a line a row, with a head."""
    width = max(len(row.quantity) for row in table)
    lines = [f"{'':{width}}  {'paper':>5}  {'ours':>5}"]
    for row in table:
        paper = "" if row.paper is None else f"{row.paper:.1f}"
        spread = "" if row.spread is None else f" ± {row.spread:.3f}"
        lines.append(f"{row.quantity:{width}}  {paper:>5}  {row.ours:.3f}{spread}")
    return "\n".join(lines)
