"""Validity: what a right mesh of a terrain is, and where a given one is not.

Checked: finite coordinates; triangles of three distinct vertices, with an area, counter-clockwise
from above; no vertex or triangle twice; every vertex in some triangle; at most two triangles on an
edge, one on each side; and no *hanging* vertex, one that lies inside an edge of a triangle.

Not checked: triangles that overlap otherwise than across a common edge; gaps wider than a millionth
of the edge beside them; and whether vertices 0 and 1 end the longest edge, which depends on whether
it is measured in the world or on the lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtin._distinct import distinct
from rtin._edges import directed_edges, edge_ends, undirected_keys
from rtin.mesh import TriangleMesh, require_mesh

__all__ = ["InvalidMesh", "check", "check_triangles", "complaints", "has_gaps", "is_closed"]

_Numbers = NDArray[np.int64]
_Places = NDArray[np.float64]

# Of an edge's length: what lies closer to a line than this is taken to be on it. Coordinates that
# went through float32 are rounded by less, and so are those of rotated grids in UTM.
_ON_THE_LINE = 1e-6


class InvalidMesh(ValueError):  # noqa: N818  (a state of the mesh, as in the message)
    """A mesh is not a right one; the message says what is wrong first, and where."""


class _Complaint(NamedTuple):
    """One kind of fault: what is wrong where it is met first, and how often it is met."""

    first: str
    n_found: int


def check(mesh: TriangleMesh) -> None:
    """Raise InvalidMesh where a mesh is not a right one; the module says what that is.

    Raises
    ------
    InvalidMesh
        Its message names the first fault, with the numbers of the vertices and triangles involved.
    TypeError
        If ``mesh`` is not a TriangleMesh.
    """
    for complaint in _complaints(mesh):
        raise InvalidMesh(complaint.first)


def check_triangles(mesh: TriangleMesh) -> None:
    """Raise what ``check`` raises, but let vertices pass that belong to no triangle."""
    for complaint in _complaints(mesh, [find for find in _FINDERS if find is not _unused]):
        raise InvalidMesh(complaint.first)


def has_gaps(mesh: TriangleMesh, boundary: _Numbers) -> bool:
    """Return whether boundary edges hide a hanging vertex, or vertices at the same place.

    ``boundary`` numbers them ``3 * triangle + side``, as found in an otherwise right mesh.
    """
    owners, sides = np.divmod(boundary, 3)
    triangles = mesh.triangles[owners]
    ends = np.column_stack([mesh.triangles[owners, sides], mesh.triangles[owners, (sides + 1) % 3]])
    places = mesh.vertices[:, :2]
    rim = places[distinct(ends.ravel())]
    rim = rim[np.lexsort(rim.T)]
    repeated = bool((np.diff(rim, axis=0) == 0.0).all(axis=1).any())
    return repeated or len(_hanging(places, ends.astype(np.int64), triangles)) > 0


def complaints(mesh: TriangleMesh) -> list[str]:
    """Return one line for each kind of fault of a mesh: the first of them, and how many there are.

    An empty list is a right mesh. Faults may come together: a hole torn by a wrong vertex number
    is seen as hanging vertices too.
    """
    return [
        first if n_found == 1 else f"{first} ({n_found} such)"
        for first, n_found in _complaints(mesh)
    ]


def is_closed(mesh: TriangleMesh) -> bool:
    """Return whether a mesh is the whole surface of a solid: each edge has exactly two triangles.

    Which side of a triangle is outside is not looked at: reading a terrain turns all upwards.
    """
    keys = undirected_keys(*directed_edges(mesh.triangles), mesh.n_vertices)
    uses = np.unique(keys, return_counts=True)[1]
    return mesh.n_triangles > 0 and bool((uses == 2).all())


def _complaints(
    mesh: TriangleMesh, finders: Sequence[_Finder] | None = None
) -> Iterator[_Complaint]:
    examined = _examined(require_mesh(mesh))
    for find in _FINDERS if finders is None else finders:
        complaint = find(examined)
        if complaint is not None:
            yield complaint


# --- what all of them look at -------------------------------------------------------------------


class _Edges(NamedTuple):
    """The sides of all triangles, sorted so that those with the same ends are neighbours."""

    ends: _Numbers  # (n, 2), the smaller vertex number first
    triangles: _Numbers
    sides: NDArray[np.int8]  # of the ends' direction, on which the triangle lies; 0 if it is flat
    first: _Numbers  # where each edge's sides begin
    counts: _Numbers  # and how many there are


class _Examined(NamedTuple):
    """A mesh, and what several of the searches for faults need to know of it."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    repeats_a_corner: NDArray[np.bool_]
    turns: NDArray[np.int8]  # 1 counter-clockwise, -1 clockwise, 0 without an area
    edges: _Edges


_Finder = Callable[[_Examined], _Complaint | None]


def _examined(mesh: TriangleMesh) -> _Examined:
    a, b, c = mesh.triangles.T
    repeats = (a == b) | (b == c) | (c == a)
    turns = _turns(mesh)
    return _Examined(mesh.vertices, mesh.triangles, repeats, turns, _edges(mesh, repeats, turns))


def _turns(mesh: TriangleMesh) -> NDArray[np.int8]:
    corners = mesh.vertices[mesh.triangles, :2]
    largest = np.abs(corners).max(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        sides = np.roll(corners, -1, axis=1) - corners
        longest = np.sqrt((sides**2).sum(axis=2).max(axis=1))
        areas = mesh.signed_areas()
        rounding = 4.0 * np.finfo(np.float64).eps * largest
        clear = np.abs(areas) > longest * (1e-12 * longest + rounding)
        return np.asarray(np.where(clear, np.sign(areas), 0.0), np.int8)


def _edges(mesh: TriangleMesh, repeats: NDArray[np.bool_], turns: NDArray[np.int8]) -> _Edges:
    """Return the sides of triangles of three distinct vertices."""
    sound = np.flatnonzero(~repeats)
    tails, heads = directed_edges(mesh.triangles[sound])
    keys = undirected_keys(tails, heads, mesh.n_vertices)
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    turns_of_sides = np.repeat(turns[sound], 3)
    return _Edges(
        ends=edge_ends(keys[order], mesh.n_vertices),
        triangles=np.repeat(sound, 3)[order],
        sides=np.where(tails < heads, turns_of_sides, -turns_of_sides)[order],
        first=starts,
        counts=np.diff(starts, append=len(order)),
    )


# --- vertices and triangles ---------------------------------------------------------------------


def _not_finite(mesh: _Examined) -> _Complaint | None:
    found = np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1))
    if not found.size:
        return None
    place = _numbers(mesh.vertices[found[0]])
    return _Complaint(f"vertex {found[0]} has a coordinate that is not finite: {place}", found.size)


def _repeated_corner(mesh: _Examined) -> _Complaint | None:
    found = np.flatnonzero(mesh.repeats_a_corner)
    if not found.size:
        return None
    return _Complaint(f"{_triangle(mesh, found[0])} names a vertex twice", found.size)


def _no_area(mesh: _Examined) -> _Complaint | None:
    found = np.flatnonzero((mesh.turns == 0) & ~mesh.repeats_a_corner & _has_places(mesh))
    if not found.size:
        return None
    return _Complaint(f"{_triangle(mesh, found[0])} has no area seen from above", found.size)


def _clockwise(mesh: _Examined) -> _Complaint | None:
    found = np.flatnonzero(mesh.turns < 0)
    if not found.size:
        return None
    return _Complaint(f"{_triangle(mesh, found[0])} is clockwise seen from above", found.size)


def _same_place(mesh: _Examined) -> _Complaint | None:
    x, y, _ = mesh.vertices.T
    order = np.lexsort((np.arange(len(x)), y, x))
    same = np.asarray((np.diff(x[order]) == 0.0) & (np.diff(y[order]) == 0.0))
    if not same.any():
        return None
    first, second = _earliest_pair(order, same)
    heights = "" if mesh.vertices[first, 2] == mesh.vertices[second, 2] else ", at unlike heights"
    place = _numbers(mesh.vertices[second, :2])
    message = f"vertices {first} and {second} share the place {place}{heights}"
    return _Complaint(message, int(same.sum()))


def _same_triangle(mesh: _Examined) -> _Complaint | None:
    corners = np.sort(mesh.triangles, axis=1)
    order = np.lexsort((np.arange(len(corners)), *corners.T))
    same = np.asarray((np.diff(corners[order], axis=0) == 0).all(axis=1))
    if not same.any():
        return None
    first, second = _earliest_pair(order, same)
    message = f"triangle {first} and {_triangle(mesh, second)} are the same"
    return _Complaint(message, int(same.sum()))


def _earliest_pair(order: _Numbers, same: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the pair of neighbours in ``order`` that are the same, whose second comes first."""
    at = np.flatnonzero(same)[np.argmin(order[1:][same])]
    return int(order[at]), int(order[at + 1])


def _unused(mesh: _Examined) -> _Complaint | None:
    uses = np.bincount(mesh.triangles.ravel(), minlength=len(mesh.vertices))
    found = np.flatnonzero(uses == 0)
    if not found.size:
        return None
    return _Complaint(f"vertex {found[0]} belongs to no triangle", found.size)


def _has_places(mesh: _Examined) -> NDArray[np.bool_]:
    finite = np.asarray(np.isfinite(mesh.vertices[:, :2]).all(axis=1))
    return np.asarray(finite[mesh.triangles].all(axis=1))


# --- edges --------------------------------------------------------------------------------------


def _crowded_edge(mesh: _Examined) -> _Complaint | None:
    edges = mesh.edges
    found = np.flatnonzero(edges.counts > 2)
    if not found.size:
        return None
    start, count = edges.first[found[0]], edges.counts[found[0]]
    a, b = edges.ends[start]
    triangles = ", ".join(map(str, edges.triangles[start : start + count][:5]))
    return _Complaint(f"edge {a}-{b} belongs to {count} triangles: {triangles}", found.size)


def _folded_edge(mesh: _Examined) -> _Complaint | None:
    edges = mesh.edges
    pairs = edges.first[edges.counts == 2]
    found = pairs[np.flatnonzero(edges.sides[pairs] * edges.sides[pairs + 1] > 0)]
    if not found.size:
        return None
    a, b = edges.ends[found[0]]
    one, other = edges.triangles[found[0] : found[0] + 2]
    message = f"triangles {one} and {other} overlap: both lie on the same side of edge {a}-{b}"
    return _Complaint(message, found.size)


def _hanging_vertex(mesh: _Examined) -> _Complaint | None:
    """Look along boundary edges only: between two triangles there is no room for a vertex."""
    edges = mesh.edges
    lone = edges.first[edges.counts == 1]
    ends, triangles = edges.ends[lone], edges.triangles[lone]
    finite = np.isfinite(mesh.vertices[ends, :2]).all(axis=(1, 2))
    ends, triangles = ends[finite], triangles[finite]
    pairs = _hanging(mesh.vertices[:, :2], ends, mesh.triangles[triangles])
    if not len(pairs):
        return None
    edge, vertex = pairs[np.lexsort(pairs.T)[0]]
    (a, b), place = ends[edge], _numbers(mesh.vertices[vertex, :2])
    message = f"vertex {vertex} hangs inside edge {a}-{b} of triangle {triangles[edge]}, at {place}"
    return _Complaint(message, len(np.unique(pairs[:, 1])))


def _hanging(places: _Places, ends: _Numbers, triangles: NDArray[np.int32]) -> _Numbers:
    """Return (edge, vertex) for each vertex inside an edge, whose triangle it is no corner of."""
    pairs = _vertices_inside(places, ends)
    own = (triangles[pairs[:, 0]] == pairs[:, 1:]).any(axis=1)
    return np.asarray(pairs[~own])


def _vertices_inside(places: _Places, ends: _Numbers) -> _Numbers:
    """Return (edge, vertex) for each end of an edge that lies inside another edge."""
    if not len(ends):
        return np.empty((0, 2), np.int64)
    edge, vertex = _vertices_near(places, ends)
    a, b, point = places[ends[edge, 0]], places[ends[edge, 1]], places[vertex]
    along, to_point = b - a, point - a
    length_squared = (along**2).sum(axis=1)
    across = np.abs(along[:, 0] * to_point[:, 1] - along[:, 1] * to_point[:, 0])
    ahead = (along * to_point).sum(axis=1)
    margin = _ON_THE_LINE * length_squared
    inside = (across < margin) & (ahead > margin) & (ahead < length_squared - margin)
    inside &= (vertex != ends[edge, 0]) & (vertex != ends[edge, 1])
    return np.unique(np.column_stack([edge[inside], vertex[inside]]), axis=0)


def _vertices_near(places: _Places, ends: _Numbers) -> tuple[_Numbers, _Numbers]:
    """Return pairs of an edge and an end of another one, all those that lie on it among them.

    Both are sorted into square bins as wide as an edge is on average, so that edges take up few
    bins and bins hold few vertices. An edge is followed in half bins; what lies on it is at most a
    quarter of a bin from one of these stops, east or west and north or south.
    """
    tails, heads = places[ends[:, 0]], places[ends[:, 1]]
    lengths = np.abs(heads - tails).max(axis=1)
    width = lengths.mean()
    if width == 0.0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    n_stops = np.ceil(2.0 * lengths / width).astype(np.int64) + 1
    edge, stop = _counted_out(n_stops)
    share = (stop / (n_stops[edge] - 1).clip(1))[:, np.newaxis]
    stops = tails[edge] + share * (heads - tails)[edge]
    corner = places[ends].min(axis=(0, 1))
    vertices = distinct(ends.ravel())
    bin_of = _bins((places[vertices] - corner) / width)
    order = np.argsort(bin_of, kind="stable")
    bins, first, counts = np.unique(bin_of[order], return_index=True, return_counts=True)
    reach = 0.26 * width
    visits = distinct(
        np.concatenate(
            [
                _visits(edge, _bins((stops - corner + (dx, dy)) / width), bins)
                for dx in (-reach, reach)
                for dy in (-reach, reach)
            ]
        )
    )
    edge, filled_bin = np.divmod(visits, len(bins))
    visit, offset = _counted_out(counts[filled_bin])
    return edge[visit], vertices[order[first[filled_bin][visit] + offset]]


def _visits(edge: _Numbers, wanted: _Numbers, bins: _Numbers) -> _Numbers:
    """Return edge * len(bins) + bin for each edge at a bin that holds a vertex."""
    which = np.searchsorted(bins, wanted).clip(max=len(bins) - 1)
    filled = bins[which] == wanted
    return np.asarray(edge[filled] * len(bins) + which[filled])


def _bins(places: _Places) -> _Numbers:
    cells = np.floor(places).astype(np.int64)
    return np.asarray(cells[:, 0] * (1 << 31) + cells[:, 1])


def _counted_out(counts: _Numbers) -> tuple[_Numbers, _Numbers]:
    """Return which count and how far: (0, 0, 2, 2, 2) and (0, 1, 0, 1, 2) for (2, 0, 3)."""
    which = np.repeat(np.arange(len(counts)), counts)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)


# --- words --------------------------------------------------------------------------------------


def _triangle(mesh: _Examined, triangle: int) -> str:
    a, b, c = mesh.triangles[triangle]
    return f"triangle {triangle} ({a}, {b}, {c})"


def _numbers(values: _Places) -> str:
    return "(" + ", ".join(f"{value:.10g}" for value in values) + ")"


_FINDERS: tuple[_Finder, ...] = (
    _not_finite,
    _repeated_corner,
    _no_area,
    _clockwise,
    _same_place,
    _same_triangle,
    _crowded_edge,
    _folded_edge,
    _hanging_vertex,
    _unused,
)
