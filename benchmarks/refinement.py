"""Refinement beside scikit-fem, MFEM and NGSolve: the same triangles, one process, taking turns.

python benchmarks/refinement.py [--only TABLE] [--triangles N] [--repeats N] [--json]

Tables: peers, adaptive, growth, and memory (a process for each case, on Linux).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from statistics import median
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

import rtin
from measuring import Duel, milliseconds, seconds, seconds_and_cpu, show
from memory import peak_while

Row = dict[str, object]
Mask = NDArray[np.bool_]
SHARES = {"1 %": 0.01, "all": 1.0}
CALLS = {1: 200, 10: 50, 100: 20, 1000: 10, 10**4: 5, 10**5: 3}  # of each number of targets


# --- meshes -------------------------------------------------------------------------------------


def lattice(n_triangles: int) -> rtin.TriangleMesh:
    """Return a unit square of right isosceles triangles, whose diagonals alternate."""
    n = round((n_triangles / 2) ** 0.5)
    rows, cols = (axis.ravel() for axis in np.mgrid[:n, :n])
    a = rows * (n + 1) + cols
    b, c, d = a + 1, a + n + 2, a + n + 1
    pairs = np.array([[c, a, b, a, c, d], [b, d, a, d, b, c]], np.int32)
    triangles = np.where((rows + cols) % 2 == 0, *pairs).T.reshape(-1, 3)
    y, x = (axis.ravel() / n for axis in np.mgrid[: n + 1, : n + 1])
    return rtin.TriangleMesh(np.column_stack([x, y, np.zeros_like(x)]), triangles)


def random_tin(n_triangles: int) -> rtin.TriangleMesh:
    """Return the Delaunay triangles of random points, numbered as they come."""
    points = np.random.default_rng(2024).random((n_triangles // 2, 2))
    vertices = np.column_stack([points, np.zeros(len(points))])
    return rtin.TriangleMesh.from_triangles(vertices, Delaunay(points).simplices)


def random_targets(mesh: rtin.TriangleMesh, share: float) -> Mask:
    return np.random.default_rng(7).random(mesh.n_triangles) < share


MESHES = {"lattice": lattice, "Delaunay": random_tin}


# --- the peers ----------------------------------------------------------------------------------


class Peer(Protocol):
    """A library that refines. Only ``refine`` is timed; it may change the mesh it is given."""

    name: str

    def mesh(self, mesh: rtin.TriangleMesh, targets: Mask) -> object:
        """Return the library's mesh, with all that it keeps beside the triangles."""

    def refine(self, mesh: object, targets: Mask) -> object:
        """Return the refined mesh, by the library's call for all triangles if all are meant."""

    def arrays(self, mesh: object) -> tuple[NDArray, NDArray]:
        """Return coordinates (n, 2) and triangles (m, 3)."""


class ScikitFem:
    name = "scikit-fem"

    def __init__(self):
        import skfem

        self.library = skfem

    def mesh(self, mesh, targets):  # noqa: ARG002
        columns = (np.ascontiguousarray(a.T) for a in (mesh.vertices[:, :2], mesh.triangles))
        return self.library.MeshTri(*columns)  # finds its edges when refined, as rtin does

    def refine(self, mesh, targets):
        return mesh.refined(1) if targets.all() else mesh.refined(np.flatnonzero(targets))

    def arrays(self, mesh):
        return mesh.p.T, mesh.t.T


class Mfem:
    name = "MFEM"

    def __init__(self):
        import mfem.ser

        self.library = mfem.ser

    def mesh(self, mesh, targets):
        theirs = self.library.Mesh(2, mesh.n_vertices, mesh.n_triangles)
        for x, y in mesh.vertices[:, :2].tolist():
            theirs.AddVertex(x, y)
        for corners in mesh.triangles.tolist():
            theirs.AddTriangle(*corners)
        theirs.FinalizeTriMesh(1, 1, True)  # with edges, and longest edges marked
        return theirs, self.library.intArray(np.flatnonzero(targets).tolist())

    def refine(self, mesh, targets):
        theirs, numbers = mesh
        if targets.all():
            theirs.UniformRefinement()
        else:
            theirs.GeneralRefinement(numbers, 0)  # 0: no hanging nodes
        return theirs

    def arrays(self, mesh):
        corners, attributes = self.library.intArray(), self.library.intArray()
        mesh.GetElementData(self.library.Geometry.TRIANGLE, corners, attributes)
        triangles = np.array(corners.GetDataArray()).reshape(-1, 3)
        return np.array(mesh.GetVertexArray()), triangles


class Ngsolve:
    name = "NGSolve"

    def __init__(self):
        import netgen.meshing
        import ngsolve

        self.netgen, self.library = netgen.meshing, ngsolve

    def mesh(self, mesh, targets):
        raw = self.netgen.Mesh(dim=2)
        raw.AddPoints(mesh.vertices)
        raw.Add(self.netgen.FaceDescriptor(surfnr=1, domin=1, bc=1))
        raw.AddElements(dim=2, index=1, data=mesh.triangles, base=0)
        # No boundary segments: refining them takes a geometry, and they would only add work.
        theirs = self.library.Mesh(raw)
        theirs.SetRefinementFlags(targets.tolist())
        return theirs

    def refine(self, mesh, targets):  # noqa: ARG002
        with self.library.TaskManager():  # its threads; takes 0.6 to 0.8 of the time without
            mesh.Refine()
        return mesh

    def arrays(self, mesh):
        nodes = mesh.ngmesh.Elements2D().NumPy()["nodes"]
        return np.array(mesh.ngmesh.Coordinates())[:, :2], nodes[:, :3] - 1


def installed_peers() -> Iterator[Peer]:
    for peer in (ScikitFem, Mfem, Ngsolve):
        try:
            yield peer()
        except ImportError as error:
            note(f"{peer.name} is left out: {error}")


def note(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


# --- what a refined mesh must be ----------------------------------------------------------------


def without_gaps(points: NDArray, triangles: NDArray) -> float:
    """Return how long the boundary is; a hanging node would make it longer.

    Raises an AssertionError where an edge belongs to more than two triangles.
    """
    sides = np.sort(np.concatenate([triangles[:, [i, i - 1]] for i in range(3)]), axis=1)
    keys = np.sort(sides[:, 0].astype(np.int64) * len(points) + sides[:, 1])
    starts = np.flatnonzero(np.diff(keys, prepend=-1))
    uses = np.diff(starts, append=len(keys))
    assert uses.max() <= 2, "an edge belongs to more than two triangles"
    ends = np.divmod(keys[starts[uses == 1]], len(points))
    return float(np.linalg.norm(points[ends[0], :2] - points[ends[1], :2], axis=1).sum())


def unrefined(mesh: rtin.TriangleMesh, targets: Mask, points: NDArray, triangles: NDArray) -> int:
    """Return how many targets are still triangles of the refined mesh."""
    assert np.array_equal(points[: mesh.n_vertices, :2], mesh.vertices[:, :2])
    kept = triangles[triangles.max(axis=1) < mesh.n_vertices]
    asked = mesh.triangles[targets]
    together = np.sort(np.concatenate([np.unique(np.sort(kept, axis=1), axis=0), asked]), axis=1)
    return len(together) - len(np.unique(together, axis=0))


def verdict(mesh: rtin.TriangleMesh, targets: Mask, points: NDArray, triangles: NDArray) -> str:
    left = unrefined(mesh, targets, points, triangles)
    if left:
        return f"{left} targets left"
    before = without_gaps(mesh.vertices, mesh.triangles)
    return "yes" if np.isclose(without_gaps(points, triangles), before) else "hanging nodes"


# --- beside peers -------------------------------------------------------------------------------


def turns(
    ours: Callable[[], object], peer: Peer, mesh: rtin.TriangleMesh, targets: Mask, repeats: int
) -> Duel:
    """Time both in turns, after a warm-up; the peer's mesh is made anew before its clock starts."""
    ours()
    few = lattice(1000)
    peer.refine(peer.mesh(few, random_targets(few, 0.1)), random_targets(few, 0.1))
    rounds = []
    for _ in range(repeats):
        theirs = partial(peer.refine, peer.mesh(mesh, targets), targets)
        rounds.append(seconds_and_cpu(ours) + seconds_and_cpu(theirs))
    our_wall, our_cpu, their_wall, their_cpu = (list(times) for times in zip(*rounds, strict=True))
    return Duel(our_wall, their_wall, our_cpu, their_cpu)


def beside(peer: Peer, mesh: rtin.TriangleMesh, targets: Mask, repeats: int) -> Row:
    ours = partial(rtin.refine, mesh, targets)
    times = turns(ours, peer, mesh, targets, repeats)
    refined = ours()
    theirs = peer.arrays(peer.refine(peer.mesh(mesh, targets), targets))
    checks = [
        verdict(mesh, targets, *arrays)
        for arrays in ((refined.vertices, refined.triangles), theirs)
    ]
    return {
        "peer": peer.name,
        "triangles": mesh.n_triangles,
        "after": refined.n_triangles,
        "peer's": len(theirs[1]),
        "rtin ms": milliseconds(median(times.ours)),
        "best": milliseconds(min(times.ours)),
        "peer ms": milliseconds(median(times.theirs)),
        "its best": milliseconds(min(times.theirs)),
        "ratio": times.ratio,
        "of best": times.ratio_of_best,
        "of cpu": times.ratio_of_work,
        "conforming": " / ".join(checks),
    }


def beside_peers(n_triangles: int, repeats: int) -> Iterator[Row]:
    """Yield times of refining 1 % and all of two meshes, by us and each peer."""
    peers = list(installed_peers())
    for name, make in MESHES.items():
        mesh = make(n_triangles)
        for label, share in SHARES.items():
            targets = random_targets(mesh, share)
            for peer in peers:
                note(f"{name}, {label}: {peer.name}")
                yield {"mesh": name, "targets": label} | beside(peer, mesh, targets, repeats)


# --- AdaptiveMesh -------------------------------------------------------------------------------


def refine_and_undo(adaptive: rtin.AdaptiveMesh, targets: NDArray) -> Row:
    """Return times of refining targets, and of coarsening what is new."""
    n_before = adaptive.n_triangles
    refined, new = seconds_and_result(partial(adaptive.refine, targets))
    added = adaptive.n_triangles - n_before
    coarsened = seconds(partial(adaptive.coarsen, new))
    left = adaptive.n_triangles - n_before
    return {
        "added": added,
        "refine µs": 1e6 * refined,
        "/ target": 1e6 * refined / len(targets),
        "/ added": 1e6 * refined / added,
        "coarsen µs": 1e6 * coarsened,
        "/ removed": 1e6 * coarsened / max(1, added - left),
        "left": left,
    }


def seconds_and_result(function: Callable[[], object]) -> tuple[float, object]:
    start = time.perf_counter()
    result = function()
    return time.perf_counter() - start, result


def random_batches(n_triangles: int, repeats: int) -> Iterator[Row]:  # noqa: ARG001
    """Yield times of AdaptiveMesh for ever more random targets: medians over the calls."""
    rng = np.random.default_rng(7)
    for name, make in MESHES.items():
        adaptive = rtin.AdaptiveMesh(make(n_triangles))
        refine_and_undo(adaptive, np.array([0]))  # compiles, and makes room for as many again
        for n_targets, calls in CALLS.items():
            if n_targets > n_triangles // 4:
                continue
            note(f"AdaptiveMesh of {name}: {n_targets} targets")
            row: Row = {"mesh": name, "triangles": adaptive.n_triangles, "targets": n_targets}
            rows = [
                refine_and_undo(adaptive, rng.choice(adaptive.n_triangles, n_targets, False))
                for _ in range(calls)
            ]
            row |= {key: median(row[key] for row in rows) for key in rows[0]}
            yield row | {".mesh ms": milliseconds(seconds(partial(getattr, adaptive, "mesh")))}


# --- growth -------------------------------------------------------------------------------------


def refine_case(mesh: rtin.TriangleMesh, share: float) -> Callable[[], object]:
    return partial(rtin.refine, mesh, random_targets(mesh, share))


def adaptive_case(mesh: rtin.TriangleMesh, share: float) -> Callable[[], object]:
    """Return the first refinement of an AdaptiveMesh, which is made before the clock starts."""
    return partial(rtin.AdaptiveMesh(mesh).refine, random_targets(mesh, share))


def setup_case(mesh: rtin.TriangleMesh, share: float) -> Callable[[], object]:  # noqa: ARG001
    return partial(rtin.AdaptiveMesh, mesh)


GROWTH = {
    "refine, 1 %": (refine_case, 0.01),
    "refine, all": (refine_case, 1.0),
    "AdaptiveMesh(mesh)": (setup_case, 0.0),
    "AdaptiveMesh.refine, 1 %": (adaptive_case, 0.01),
    "AdaptiveMesh.refine, all": (adaptive_case, 1.0),
}


def growth(n_triangles: int, repeats: int) -> Iterator[Row]:
    """Yield times per triangle of ever larger lattices, up to ten times the usual one."""
    for size in (n_triangles // 100, n_triangles // 10, n_triangles, 10 * n_triangles):
        mesh = lattice(size)
        note(f"growth: {mesh.n_triangles} triangles")
        row: Row = {"triangles": mesh.n_triangles}
        for label, (case, share) in GROWTH.items():
            case(mesh, share)()
            times = [seconds(case(mesh, share)) for _ in range(repeats)]
            row[label] = 1e9 * median(times) / mesh.n_triangles
        yield row


# --- memory -------------------------------------------------------------------------------------


def peak_of(label: str, n_triangles: int) -> Row:
    """Return the peak memory of a case of GROWTH in this process."""
    case, share = GROWTH[label]
    case(lattice(1000), share)()  # compile first
    mesh = lattice(n_triangles)
    call = case(mesh, share)
    before, peak, result = peak_while(call)
    after = result.n_triangles if isinstance(result, rtin.TriangleMesh) else "-"
    return {
        "case": label,
        "triangles": mesh.n_triangles,
        "after": after,
        "mesh MiB": (mesh.vertices.nbytes + mesh.triangles.nbytes) / 2**20,
        "before MiB": before / 2**20,
        "peak MiB": peak / 2**20,
        "beyond MiB": (peak - before) / 2**20,
        "beyond / triangle": (peak - before) / mesh.n_triangles,
    }


def memory_of_largest(n_triangles: int, repeats: int) -> Iterator[Row]:  # noqa: ARG001
    """Yield the peak memory of each case of growth, ten times the usual size, each on its own."""
    for label in GROWTH:
        note(f"memory: {label}")
        command = [sys.executable, __file__, "--peak-of", label]
        command += ["--triangles", str(10 * n_triangles)]
        yield json.loads(subprocess.run(command, check=True, capture_output=True).stdout)


TABLES = {
    "peers": ("refine beside peers; conforming: rtin / peer", beside_peers),
    "adaptive": ("AdaptiveMesh: refine random targets, and coarsen them again", random_batches),
    "growth": ("nanoseconds per triangle of the mesh that is refined", growth),
    "memory": ("peak memory of the process, and beyond what it held before", memory_of_largest),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, default=10**6, help="about how many in a mesh")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", choices=TABLES, action="append", help="one table or several")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--peak-of", choices=GROWTH, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.peak_of:
        print(json.dumps(peak_of(options.peak_of, options.triangles)))
        return
    tables = {}
    for key in options.only or TABLES:
        title, rows_of = TABLES[key]
        tables[title] = list(rows_of(options.triangles, options.repeats))
    show(tables, options.json)


if __name__ == "__main__":
    main()
