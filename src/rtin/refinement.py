"""Refinement: split triangles where they are too large, and keep the mesh conforming.

The algorithm is RTIN-Refinement of Suárez and Plaza, "Four-triangles adaptive algorithms for RTIN
terrain meshes": bisect the targets' edges, walk over longest edges until the marks conform, then
split each triangle by its marks. It works on every conforming triangle mesh.

A triangle is bisected first along the edge from its vertex 0 to its vertex 1, which is its longest
one in any mesh from ``coarsen``, ``read_mesh`` or ``TriangleMesh.from_triangles``. Angles then stay
above half of the smallest one there was (Rosenberg and Stenger, 1975), and right isosceles
triangles stay so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin import _parallel
from rtin._adjacency import require_numbers, twins_of
from rtin._distinct import distinct
from rtin._options import as_height, as_tolerance_map, the_only_option
from rtin.criteria import triangles_off
from rtin.grid import Grid, require_grid
from rtin.mesh import TriangleMesh, require_mesh

__all__ = [
    "SCHEMES",
    "Scheme",
    "as_heights",
    "as_scheme",
    "as_targets",
    "lift",
    "refine",
    "refine_to",
    "require_triangles",
    "too_small_to_split",
]

Targets: TypeAlias = ArrayLike
Criterion: TypeAlias = Callable[[TriangleMesh], ArrayLike]
_Mask = NDArray[np.bool_]
_Bands: TypeAlias = list[tuple[int, int]]

_ROUNDED = 1e-3  # cells that rounding may have moved a vertex by
_SHORTEST_EDGE = 1.5  # cells; a hair more than the longest edge between samples of one cell


class Scheme(NamedTuple):
    """What refining a target means to the kernels."""

    sides: int  # of the target that are bisected, a bit each; bit 0 is the longest one
    pattern: int  # of triangles of which all sides are bisected


SCHEMES = {"4T-LE": Scheme(7, 0), "4T-SS": Scheme(7, 1), "bisection": Scheme(1, 0)}


def refine(
    mesh: TriangleMesh,
    targets: Targets | Criterion,
    scheme: str = "4T-LE",
    *,
    heights: Grid | None = None,
) -> TriangleMesh:
    """Return ``mesh`` with the targets split, and as many triangles around them as it then takes.

    Parameters
    ----------
    mesh : TriangleMesh
        Conforming; vertices 0 and 1 of each triangle end the edge to bisect first.
    targets : array_like or callable
        Numbers of triangles (in any order, repeated or not), or a boolean for each triangle. A
        callable gets the mesh, returns one of these, and is asked again of the refined mesh until
        it marks nothing; that it comes to an end is its own affair.
    scheme : {"4T-LE", "4T-SS", "bisection"}
        What becomes of a target. 4T-LE: four triangles, by the midpoint of the longest edge and the
        midpoints of the other two joined to it. 4T-SS: four triangles similar to the target, by
        joining the three midpoints (of right triangles both make the same shapes). bisection: two
        triangles. With all triangles as targets the first two refine uniformly.
    heights : Grid, optional
        Gives new vertices their heights (see ``Grid.heights_at``), where it has any. Otherwise a
        new vertex lies in the middle of its edge.

    Returns
    -------
    TriangleMesh
        Conforming. The vertices of ``mesh`` come first, then the midpoints, in the order in which
        one meets them walking through the triangles of ``mesh`` and in each over sides 0, 1, 2.
        Triangles come in the order of ``mesh``; a split one's place is taken by its children:

        =================  =============================================
        sides bisected     children of (a, b, c); m, p, q on ab, bc, ca
        =================  =============================================
        ab                 cam bcm
        ab, bc             cam mbp cmp
        ab, ca             mcq amq bcm
        all, 4T-LE         mcq amq mbp cmp
        all, 4T-SS         qpc amq mbp pqm
        =================  =============================================

        Each is then rotated so that vertices 0 and 1 end its longest edge, in the xy plane. Where
        edges tie within a millionth, the one most along a fixed direction is taken, the same from
        both sides; but where the two at the new vertex tie, as after bisecting a right triangle,
        the third one. Children inherit tags, and cover exactly their parent.

    Raises
    ------
    InvalidMesh
        If ``mesh`` is not conforming (see ``validity``): the message says what is wrong and where.
    IndexError
        If a target does not exist.
    ValueError
        If the scheme is unknown, a mask has not one value for each triangle, a triangle is so small
        that float64 cannot split it, or the mesh would have more triangles than int32 can number.
    TypeError
        If targets are not whole numbers or booleans, or an argument is of the wrong kind.

    Notes
    -----
    Not guaranteed: that few triangles are split besides the targets. Seven on average is what
    right-triangulated meshes come to (``propagation`` tells), but a strip of ever longer triangles
    can be split as a whole by one target.
    """
    require_mesh(mesh)
    split, heights = as_scheme(scheme), as_heights(heights)
    if not callable(targets):
        return _refined(mesh, as_targets(targets, mesh.n_triangles), split, heights).mesh
    while (marked := as_targets(targets(mesh), mesh.n_triangles)).size:
        mesh = _refined(mesh, marked, split, heights).mesh
    return mesh


def refine_to(
    mesh: TriangleMesh,
    grid: Grid,
    *,
    threshold: float | None = None,
    max_error: ArrayLike | None = None,
    scheme: str = "bisection",
) -> TriangleMesh:
    """Return ``mesh`` with heights from ``grid``, refined until it fits them.

    The paper's top-down use of Eq. (1), from any mesh over the raster. All vertices, those of
    ``mesh`` too, get the raster's height at their place (``Grid.heights_at``), where it has one.
    Those within a thousandth of a cell of a sample are moved onto it: rounding to 32 bits, as in a
    GLB, shifts them by less, and would leave slivers between vertex and sample.

    Parameters
    ----------
    mesh : TriangleMesh
        Conforming, in the coordinates of the grid.
    grid : Grid
    threshold : float
        Refine triangles whose longest edge has a midpoint v with E(v) > ε, Eq. (1): the paper's
        criterion. It promises nothing about the surface, and looks no closer than the raster:
        edges shorter than one and a half cells are left as they are. Equality is accepted here,
        as in the paper's refinement; ``coarsen`` keeps a vertex with E(v) = ε, as its coarsening.
    max_error : float, or array_like of the grid's shape
        Refine triangles that are farther than this from a sample under them, vertically.
    scheme : {"4T-LE", "4T-SS", "bisection"}
        As in ``refine``. "bisection" takes most rounds and makes the fewest triangles: the others
        about twice as many.

    Returns
    -------
    TriangleMesh
        Conforming, in the order of ``refine`` applied again and again. With ``max_error``, every
        valid sample that the mesh covers is within that of it, vertically, as ``vertical_error``
        measures it. The mesh is not the least one: of meshes over a raster, ``coarsen`` gives that.

    Raises
    ------
    ValueError
        If not exactly one criterion is given, it is negative or NaN, the mesh lies beside the
        raster, or float64 is too coarse to come closer, as may happen at ``max_error=0`` where the
        mesh's edges do not meet the samples.
    InvalidMesh, TypeError
        As ``refine`` does.
    """
    require_mesh(mesh)
    require_grid(grid)
    split = as_scheme(scheme)
    name, value = the_only_option(threshold=threshold, max_error=max_error)
    tolerance = _as_tolerance(name, value, grid)
    _require_overlap(mesh, grid)
    twins_of(mesh)  # for its complaints: a mesh of which nothing is refined is checked as well
    find = _over_threshold if max_error is None else _off_by_more
    vertices = _on_samples(mesh.vertices, grid)
    lift(vertices, grid)
    lifted = TriangleMesh(vertices, mesh.triangles, mesh.crs, mesh.tags)
    mesh, is_new = lifted, np.ones(mesh.n_triangles, np.bool_)
    while (marked := np.flatnonzero(find(mesh, grid, tolerance, is_new))).size:
        step = _refined(mesh, marked, split, grid)
        mesh, is_new = step.mesh, step.is_new()
    return mesh


# --- at the door --------------------------------------------------------------------------------


def as_scheme(name: str) -> Scheme:
    """Return the scheme of that name, or raise a ValueError that lists them."""
    if not isinstance(name, str) or name not in SCHEMES:
        raise ValueError(f"scheme must be one of {', '.join(SCHEMES)}, got {name!r}")
    return SCHEMES[name]


def as_heights(heights: Grid | None) -> Grid | None:
    """Return ``heights``; raise TypeError where it is neither a grid nor None."""
    return None if heights is None else require_grid(heights)


def as_targets(targets: ArrayLike, n_triangles: int) -> NDArray[np.int64]:
    """Return the numbers of the triangles meant, ascending and each once.

    Raises what ``require_triangles`` raises.
    """
    numbers = require_triangles(targets, n_triangles)
    return numbers if (np.diff(numbers) > 0).all() else distinct(numbers)


def require_triangles(given: ArrayLike, n_triangles: int) -> NDArray[np.int64]:
    """Return the numbers of the triangles meant, in the order given.

    Raises
    ------
    IndexError
        If one does not exist.
    ValueError
        If a mask has not one value for each triangle, or numbers are not in one dimension.
    TypeError
        If they are neither whole numbers nor booleans.
    """
    targets = np.asarray(given)
    if targets.dtype == np.bool_ and targets.ndim == 1:
        if targets.shape != (n_triangles,):
            raise ValueError(
                f"a mask of triangles must have a value for each of {n_triangles}, "
                f"got {targets.size}"
            )
        return np.flatnonzero(targets)
    if targets.size == 0:
        return np.empty(0, np.int64)
    if targets.dtype.kind not in "iu":
        raise TypeError(
            "numbers of triangles or a boolean for each are wanted, got "
            + (
                type(given).__name__
                if targets.dtype == object
                else f"an array of {targets.dtype} with shape {targets.shape}"
            )
        )
    if targets.ndim != 1:
        raise ValueError(
            f"numbers of triangles must be in one dimension, got shape {targets.shape}"
        )
    low, high = targets.min(), targets.max()
    if low < 0 or high >= n_triangles:
        raise IndexError(
            f"there are {n_triangles} triangles, numbered from 0; got {low if low < 0 else high}"
        )
    return targets.astype(np.int64)


def _as_tolerance(name: str, value: ArrayLike, grid: Grid) -> NDArray[np.float64]:
    """Return one number or one for each sample, in two dimensions."""
    if name == "threshold" or np.ndim(value) == 0:
        return np.full((1, 1), as_height(name, value))
    return as_tolerance_map(grid, name, value)


def _require_overlap(mesh: TriangleMesh, grid: Grid) -> None:
    places = grid.places(mesh.vertices[:, :2])
    last = np.subtract(grid.shape, 1)
    if not len(places) or (places.max(axis=0) < 0.0).any() or (places.min(axis=0) > last).any():
        raise ValueError("the mesh lies beside the grid; bring both into the same coordinates")


# --- steps --------------------------------------------------------------------------------------


class _Step(NamedTuple):
    """A refined mesh, and the marks of the triangles that it was refined from."""

    mesh: TriangleMesh
    marks: NDArray[np.uint8]

    def is_new(self) -> _Mask:
        """Return which triangles came of a split."""
        return np.repeat(self.marks > 0, _n_children(self.marks))


def _refined(
    mesh: TriangleMesh, targets: NDArray[np.int64], scheme: Scheme, heights: Grid | None
) -> _Step:
    """Mark, propagate, and split: the steps of RTIN-Refinement."""
    twins = twins_of(mesh)
    marks = _marked(targets, scheme, twins)
    bands = _parallel.row_bands(mesh.n_triangles)
    counts = _counted(marks, twins, bands)
    vertices = _with_midpoints(mesh, marks, twins, bands, mesh.n_vertices + counts[:, 0])
    if heights is not None:
        lift(vertices[mesh.n_vertices :], heights)
    triangles = _split(mesh, marks, twins, scheme, bands, counts[:, 1], vertices)
    tags = None if mesh.tags is None else np.repeat(mesh.tags, _n_children(marks))
    return _Step(TriangleMesh(vertices, triangles, mesh.crs, tags), marks)


def _on_samples(vertices: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """Return vertices with those that are very close to a sample on it, if they are alone there."""
    places = grid.places(vertices[:, :2])
    nearest = np.rint(places)
    close = np.flatnonzero((np.abs(places - nearest) < _ROUNDED).all(axis=1))
    _, which, counts = np.unique(nearest[close], axis=0, return_inverse=True, return_counts=True)
    close = close[counts[which.ravel()] == 1]
    moved = vertices.copy()
    a, b, x0, d, e, y0 = tuple(grid.transform)[:6]
    row, col = nearest[close].T
    moved[close, 0], moved[close, 1] = x0 + a * col + b * row, y0 + d * col + e * row
    return moved


def lift(vertices: NDArray[np.float64], grid: Grid) -> None:
    """Give vertices the heights of ``grid`` at their places, where it has any."""
    heights = grid.heights_at(vertices[:, :2])
    np.copyto(vertices[:, 2], heights, where=~np.isnan(heights))


def _marked(
    targets: NDArray[np.int64], scheme: Scheme, twins: NDArray[np.int32]
) -> NDArray[np.uint8]:
    """Return the sides of each triangle that are bisected, a bit each."""
    from rtin._kernels.refinement import ALL_SIDES, mark_and_propagate

    n_triangles = len(twins) // 3
    if len(targets) == n_triangles and scheme.sides == ALL_SIDES:
        return np.full(n_triangles, ALL_SIDES, np.uint8)
    marks = np.zeros(n_triangles, np.uint8)
    marked = np.empty(n_triangles, np.int32)
    mark_and_propagate(targets, scheme.sides, twins.reshape(-1, 3), marks, marked)
    return marks


def _n_children(marks: NDArray[np.uint8]) -> NDArray[np.int64]:
    from rtin._kernels.refinement import N_CHILDREN

    return np.asarray(N_CHILDREN[marks])


def _counted(
    marks: NDArray[np.uint8], twins: NDArray[np.int32], bands: _Bands
) -> NDArray[np.int64]:
    """Return how many new vertices and triangles come before each band, and in all."""
    from rtin._kernels.refinement import count_new

    counts = _parallel.run(count_new, [(marks, twins, *band) for band in bands])
    before = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
    require_numbers(int(before[-1, 1]))
    return before


def _with_midpoints(
    mesh: TriangleMesh,
    marks: NDArray[np.uint8],
    twins: NDArray[np.int32],
    bands: _Bands,
    numbers: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the vertices and midpoints, whose numbers go into ``twins`` (see the kernel)."""
    from rtin._kernels.refinement import fill_midpoints

    vertices = np.empty((numbers[-1], 3))
    vertices[: mesh.n_vertices] = mesh.vertices
    tasks = [
        (mesh.triangles, marks, twins, *band, number, vertices)
        for band, number in zip(bands, numbers, strict=False)
    ]
    _parallel.run(fill_midpoints, tasks)
    return vertices


def _split(
    mesh: TriangleMesh,
    marks: NDArray[np.uint8],
    twins: NDArray[np.int32],
    scheme: Scheme,
    bands: _Bands,
    numbers: NDArray[np.int64],
    vertices: NDArray[np.float64],
) -> NDArray[np.int32]:
    """Return the children of all triangles."""
    from rtin._kernels.refinement import fill_children

    children = np.empty((numbers[-1], 3), np.int32)
    tasks = [
        (mesh.triangles, marks, twins, scheme.pattern, *band, vertices, number, children)
        for band, number in zip(bands, numbers, strict=False)
    ]
    too_small = [triangle for triangle in _parallel.run(fill_children, tasks) if triangle >= 0]
    if too_small:
        raise too_small_to_split(mesh.vertices, mesh.triangles[too_small[0]])
    return children


def too_small_to_split(vertices: NDArray[np.float64], triangle: NDArray[np.int32]) -> ValueError:
    """Return what to say of a triangle whose children would have no area in float64."""
    places = ", ".join(f"({x:.17g}, {y:.17g})" for x, y in vertices[triangle, :2])
    return ValueError(
        f"a triangle is too small or too thin to be split in float64: {places}; "
        "refine less there, or move the mesh closer to the origin"
    )


# --- criteria -----------------------------------------------------------------------------------


def _over_threshold(
    mesh: TriangleMesh, grid: Grid, threshold: NDArray[np.float64], wanted: _Mask
) -> _Mask:
    """Return which of the wanted triangles have E(v) > ε, Eq. (1), midway on their longest edge."""
    chosen = np.flatnonzero(wanted)
    a, b = mesh.vertices[mesh.triangles[chosen, :2]].transpose(1, 0, 2)
    errors = np.abs((a[:, 2] + b[:, 2]) / 2.0 - grid.heights_at((a[:, :2] + b[:, :2]) / 2.0))
    lengths = np.linalg.norm(grid.places(a[:, :2]) - grid.places(b[:, :2]), axis=1)
    over = np.zeros(len(wanted), np.bool_)
    over[chosen] = (errors > threshold[0, 0]) & (lengths >= _SHORTEST_EDGE)
    return over


def _off_by_more(
    mesh: TriangleMesh, grid: Grid, max_error: NDArray[np.float64], wanted: _Mask
) -> _Mask:
    """Return which of the wanted triangles have a sample under them that is farther than ε."""
    places = grid.places(mesh.vertices[:, :2])
    z = np.ascontiguousarray(mesh.vertices[:, 2])
    return triangles_off(places, z, mesh.triangles, grid, max_error, wanted)
