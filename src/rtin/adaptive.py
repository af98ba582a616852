"""A mesh that is refined and coarsened again and again, and the fields that it carries.

Refinement is that of ``refinement``. Coarsening is its inverse, as in Suárez and Plaza,
"Four-triangles adaptive algorithms for RTIN terrain meshes": undo single edge bisections where the
mesh stays conforming, without propagation. A vertex that bisection has made can go when nothing but
that bisection's triangles are left around it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin._adjacency import require_numbers, twins_of
from rtin.grid import Grid
from rtin.mesh import TriangleMesh, require_mesh
from rtin.refinement import as_heights, as_scheme, as_targets, lift, too_small_to_split

if TYPE_CHECKING:
    import scipy.sparse

__all__ = ["AdaptiveMesh"]

_Numbers = NDArray[np.int32]
On = Literal["vertices", "triangles"]

# Room for as many again as there are, so that copying to a larger place stays rare.
_GROWTH = 2.0


class AdaptiveMesh:
    """A conforming triangle mesh that follows what an application needs.

    Each call of ``refine`` or ``coarsen`` takes time in proportion to what it changes, not to the
    mesh (but for copies to a larger place, which get rarer as the mesh grows). Reading ``mesh`` and
    transferring values takes time in proportion to the mesh.

    Triangles are numbered as in ``mesh`` at the moment. A triangle keeps its number while it is
    not split or merged, except that merging moves the last triangles into the places that become
    free. A split one's first child (in the table of ``refine``) takes its number, the others are
    appended; a merged one takes the number of its first child. Vertices keep their order; those
    that are removed leave it, and new ones may come before older ones.

    One thread at a time may use it.

    Parameters
    ----------
    mesh : TriangleMesh
        Conforming; vertices 0 and 1 of each triangle end the edge to bisect first. Its triangles
        and vertices are never coarsened away. It is copied.
    heights : Grid, optional
        Gives new vertices their heights, as in ``refine``.

    Raises
    ------
    InvalidMesh
        If ``mesh`` is not conforming.
    TypeError
        If ``mesh`` is not a TriangleMesh or ``heights`` not a Grid.

    Examples
    --------
    >>> square = TriangleMesh(
    ...     [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 2, 3], [2, 0, 1]])
    >>> adaptive = AdaptiveMesh(square)
    >>> new = adaptive.refine([0])
    >>> adaptive.n_triangles
    6
    >>> adaptive.transfer([0.0, 1.0, 2.0, 1.0])  # of the first mesh's vertices
    array([0. , 1. , 2. , 1. , 1. , 1.5, 0.5])
    >>> adaptive.coarsen(new)
    array([0, 1], dtype=int32)
    >>> adaptive.mesh.triangles.tolist()
    [[0, 2, 3], [2, 0, 1]]
    """

    def __init__(self, mesh: TriangleMesh, *, heights: Grid | None = None) -> None:
        from rtin._kernels.adaptive import N_CELL, N_NODE, State, set_up

        require_mesh(mesh)
        self._heights = as_heights(heights)
        self._crs = mesh.crs
        self._tags = None if mesh.tags is None else mesh.tags.copy()
        n, m = mesh.n_vertices, mesh.n_triangles
        self._state: Any = State(
            counts=np.array([m, n, 0, 0]),
            vertices=mesh.vertices.copy(),
            nodes=np.empty((n, N_NODE), np.int32),
            cells=np.empty((m, N_CELL), np.int32),
            marked=np.empty(m, np.int32),
        )
        set_up(mesh.triangles, twins_of(mesh), self._state)
        self._mesh: TriangleMesh | None = None
        self._change: _Change | None = _Change.none(n, m)

    # --- what it is now -------------------------------------------------------------------------

    @property
    def n_vertices(self) -> int:
        """Number of vertices."""
        _, n_slots, n_free, _ = self._state.counts.tolist()
        return int(n_slots - n_free)

    @property
    def n_triangles(self) -> int:
        """Number of triangles."""
        return int(self._state.counts[0])

    @property
    def mesh(self) -> TriangleMesh:
        """The mesh as it is now, for keeps: later changes make another one."""
        if self._mesh is None:
            used, m = self._used(), self.n_triangles
            triangles = self._state.cells[:m, :3]
            if self._state.counts[2]:
                triangles = self._numbers()[triangles]
            tags = None if self._tags is None else self._tags[self.roots]
            vertices = self._state.vertices[: len(used)][used]
            self._mesh = TriangleMesh(vertices, triangles, self._crs, tags)
        return self._mesh

    @property
    def roots(self) -> _Numbers:
        """For each triangle, the one of the initial mesh that it lies in, int32 (m,)."""
        return self._column("ROOT")

    @property
    def levels(self) -> _Numbers:
        """For each triangle, how many bisections it is from the initial mesh, int32 (m,).

        In the xy plane its area is that of its root times 0.5 ** level.
        """
        return self._column("LEVEL")

    @property
    def midpoint_parents(self) -> _Numbers:
        """For each vertex, the ends of the edge whose midpoint it is, int32 (n, 2).

        -1 for those of the initial mesh.
        """
        used = self._used()
        ends = self._state.nodes[: len(used), :2][used]
        return np.where(ends < 0, np.int32(-1), self._numbers()[ends])

    @property
    def parents(self) -> _Numbers:
        """For each triangle, the one it lay in before the last change, int32 (m,).

        After ``coarsen``, of those that were merged the one whose number the parent has taken (or
        one of two that it lay across, where just a part of 4T-SS was undone).
        """
        from rtin._kernels.adaptive import COPY

        parents = np.arange(self.n_triangles, dtype=np.int32)
        events = self._last_change().events
        copies = events[events[:, 0] == COPY]
        parents[copies[:, 1]] = copies[:, 2]
        return parents

    # --- change ---------------------------------------------------------------------------------

    def refine(self, targets: ArrayLike, scheme: str = "4T-LE") -> _Numbers:
        """Split the targets, and as many triangles around them as it then takes.

        Parameters
        ----------
        targets : array_like
            Numbers of triangles, or a boolean for each.
        scheme : {"4T-LE", "4T-SS", "bisection"}
            As in ``rtin.refine``, which makes the same triangles, in another order.

        Returns
        -------
        ndarray of int32
            Numbers of the new triangles. ``coarsen`` of all these restores the mesh to the byte.

        Raises
        ------
        IndexError, TypeError, ValueError
            As ``rtin.refine`` does; the mesh is then as it was.
        """
        from rtin._kernels.adaptive import LATEST, has_room, mark_targets, split_marked

        split = as_scheme(scheme)
        chosen = as_targets(targets, self.n_triangles)
        n, m = self.n_vertices, self.n_triangles
        if not len(chosen):
            self._change = _Change.none(n, m)
            return np.empty(0, np.int32)
        if self._state.counts[LATEST] == np.iinfo(np.int32).max:
            self._number_calls_anew()
        with self._changing():
            n_marked, n_new, n_added = mark_targets(self._state, chosen, split.sides)
            if not has_room(self._state, n_new, n_added):
                self._make_room(n_new, n_added)
            added = np.arange(m, m + n_added, dtype=np.int32)
            new = np.concatenate([self._state.marked[:n_marked], added])
            too_small, created, events = split_marked(
                self._state, n_marked, n_new, n_added, split.pattern
            )
            if too_small < 0:
                self._mesh = None
                self._change = _Change(n, m, created, np.empty(0, np.int32), events)
        if too_small >= 0:
            corners = self._state.cells[too_small, :3]
            raise too_small_to_split(self._state.vertices, corners)
        if self._heights is not None:
            raised = self._state.vertices[created]
            lift(raised, self._heights)
            self._state.vertices[created] = raised
        return new

    def coarsen(self, targets: ArrayLike) -> _Numbers:
        """Undo bisections whose triangles are all targets, where the mesh stays conforming.

        A vertex is removed when all triangles around it are targets and they are just those that
        came of bisecting its edge. What one call of ``refine`` did at a place, to whatever depth,
        can go in one call; what an earlier one did there needs another call.

        Parameters
        ----------
        targets : array_like
            Numbers of triangles, or a boolean for each.

        Returns
        -------
        ndarray of int32
            Numbers of the triangles that are new.

        Raises
        ------
        IndexError, TypeError, ValueError
            If targets are not as they should be; the mesh is then as it was.

        Notes
        -----
        Not guaranteed: that a target becomes larger. Where the triangles beside it are finer, or
        no targets, it stays. Vertices of the initial mesh stay for ever.
        """
        from rtin._kernels.adaptive import coarsen_targets

        chosen = as_targets(targets, self.n_triangles)
        n, m = self.n_vertices, self.n_triangles
        with self._changing():
            removed, events, merged = coarsen_targets(self._state, chosen)
            self._mesh = None if len(removed) else self._mesh
            self._change = _Change(n, m, np.empty(0, np.int32), removed, events)
        return np.asarray(merged)

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Stay whole if memory or the user ends the block: kernels work to their end or not at all.

        Ctrl-C during a kernel takes effect after it. What it did is lost then, but for the mesh.
        """
        from rtin._kernels.adaptive import MARKS

        before = self._state.counts.copy()
        try:
            yield
        except BaseException:
            self._state.cells[: self.n_triangles, MARKS] = 0
            if (self._state.counts != before).any():
                self._mesh = self._change = None
            raise

    def _last_change(self) -> _Change:
        if self._change is None:
            raise RuntimeError(
                "the last change was interrupted, and what it did is not known; "
                "refine or coarsen once more (nothing, if need be) to transfer from here on"
            )
        return self._change

    def _number_calls_anew(self) -> None:
        """Count calls of refine from one on again, but for gaps as before."""
        from rtin._kernels.adaptive import LATEST, STAMP

        stamps = self._state.nodes[: self._state.counts[1], STAMP]
        made = stamps > 0
        calls, places = np.unique(stamps[made], return_inverse=True)
        stamps[made] = places + 1
        self._state.counts[LATEST] = len(calls)

    def _make_room(self, n_new: int, n_added: int) -> None:
        m, n_slots, _, _ = self._state.counts.tolist()
        require_numbers(m + n_added)
        state = self._state
        self._state = state._replace(
            vertices=_grown(state.vertices, n_slots + n_new),
            nodes=_grown(state.nodes, n_slots + n_new),
            cells=_grown(state.cells, m + n_added),
            marked=_grown(state.marked, m + n_added),
        )

    # --- values ---------------------------------------------------------------------------------

    def transfer(self, values: ArrayLike, on: On = "vertices") -> NDArray[np.floating[Any]]:
        """Return values of the mesh before the last ``refine`` or ``coarsen``, for the mesh now.

        Parameters
        ----------
        values : array_like, shape (n, ...)
            One row for each vertex or triangle of the mesh before.
        on : {"vertices", "triangles"}
            Values on vertices: a new one gets the mean of its edge's ends, exact for functions
            that are linear on each triangle; the others keep theirs. Values on triangles, which
            are densities: children get their parent's, a parent the mean over its children; the sum
            of value times area in the xy plane stays the same, but for rounding.

        Returns
        -------
        ndarray of float64 (or of the values' own floating type), shape (n_now, ...)

        Raises
        ------
        ValueError
            If there are not as many values as there were vertices or triangles, or ``on`` is
            neither.
        TypeError
            If the values are not numbers.
        RuntimeError
            If the last change was interrupted, so that it is not known what it did.
        """
        given = np.asarray(values)
        if given.dtype.kind not in "biufc":
            raise TypeError(f"values must be numbers, got an array of {given.dtype}")
        if given.dtype.kind not in "fc":
            given = given.astype(np.float64)
        origin, n_before = self._origin(on), self._last_change().n_before(on)
        if given.ndim == 0 or len(given) != n_before:
            other: On = "triangles" if on == "vertices" else "vertices"
            raise ValueError(
                f"a value is wanted for each of {n_before} {on} before the last change, "
                f'got an array of shape {given.shape}; for values on {other} say on="{other}"'
            )
        carried = given[origin.sources]
        carried[origin.mixed] = 0.0
        for parts, shares in zip(origin.parts.T, origin.shares.T, strict=True):
            some = shares > 0.0  # of the others nothing: zero times infinity is no number
            weights = shares[some].reshape(-1, *[1] * (given.ndim - 1))
            carried[origin.mixed[some]] += weights * given[parts[some]]
        return carried

    def transfer_matrix(self, on: On = "vertices") -> scipy.sparse.csr_array:
        """Return the matrix by which ``transfer`` multiplies, of shape (n_now, n_before).

        Raises
        ------
        ImportError
            If SciPy is not installed.
        ValueError
            If ``on`` is neither "vertices" nor "triangles".
        """
        try:
            from scipy.sparse import csr_array
        except ModuleNotFoundError:
            raise ImportError(
                'a matrix needs SciPy, which is not installed; pip install "rtin[fem]"'
            ) from None
        origin = self._origin(on)
        single = np.ones(len(origin.sources), np.bool_)
        single[origin.mixed] = False
        rows, places = np.nonzero(origin.shares)
        values = np.concatenate([np.ones(single.sum()), origin.shares[rows, places]])
        targets = np.concatenate([np.flatnonzero(single), origin.mixed[rows]])
        sources = np.concatenate([origin.sources[single], origin.parts[rows, places]])
        shape = (len(origin.sources), self._last_change().n_before(on))
        return csr_array((values, (targets, sources)), shape=shape)

    def _origin(self, on: On) -> _Origin:
        if on == "vertices":
            return self._origin_of_vertices()
        if on == "triangles":
            return self._last_change().origin_of_triangles(self.n_triangles)
        raise ValueError(f'on must be "vertices" or "triangles", got {on!r}')

    def _origin_of_vertices(self) -> _Origin:
        change, used = self._last_change(), self._used()
        before = used.copy()
        before[change.created], before[change.removed] = False, True
        numbers_before = np.cumsum(before, dtype=np.int32) - np.int32(1)
        slots = np.flatnonzero(used)
        new = np.flatnonzero(~before[slots])
        parts = numbers_before[self._state.nodes[slots[new], :2]]
        return _Origin(numbers_before[slots], new, parts, np.full(parts.shape, 0.5))

    def _column(self, name: str) -> _Numbers:
        """Return what the kernels keep of each triangle under this name."""
        from rtin._kernels import adaptive

        return np.array(self._state.cells[: self.n_triangles, getattr(adaptive, name)])

    def _used(self) -> NDArray[np.bool_]:
        """Return which slots hold a vertex."""
        from rtin._kernels.adaptive import STAMP

        return np.asarray(self._state.nodes[: self._state.counts[1], STAMP] >= 0)

    def _numbers(self) -> _Numbers:
        """Return each slot's vertex number."""
        return np.cumsum(self._used(), dtype=np.int32) - np.int32(1)

    def __copy__(self) -> AdaptiveMesh:
        return deepcopy(self)

    def __repr__(self) -> str:
        return f"<AdaptiveMesh {self.n_vertices} vertices, {self.n_triangles} triangles>"


class _Change(NamedTuple):
    """What the last call did: slots of vertices, and events as the kernel logs them."""

    n_vertices: int  # before
    n_triangles: int
    created: _Numbers
    removed: _Numbers
    events: _Numbers  # (k, 3)

    @classmethod
    def none(cls, n_vertices: int, n_triangles: int) -> _Change:
        empty = np.empty(0, np.int32)
        return cls(n_vertices, n_triangles, empty, empty, np.empty((0, 3), np.int32))

    def n_before(self, on: On) -> int:
        return self.n_vertices if on == "vertices" else self.n_triangles

    def origin_of_triangles(self, n_triangles: int) -> _Origin:
        from rtin._kernels.adaptive import trace

        slots = np.unique(self.events[:, 1:])
        places, shares, counts = trace(self.events, slots)
        kept = slots < n_triangles
        single, several = kept & (counts == 1), kept & (counts > 1)
        sources = np.arange(n_triangles, dtype=np.int32)
        sources[slots[single]] = slots[places[single, 0]]
        return _Origin(sources, slots[several], slots[places[several]], shares[several])


class _Origin(NamedTuple):
    """Where each value comes from."""

    sources: _Numbers  # (n,) the one value before the change, for all but the mixed ones
    mixed: NDArray[np.integer[Any]]  # (k,) numbers of values that come from several
    parts: _Numbers  # (k, most): which
    shares: NDArray[np.float64]  # (k, most): how much of each; zero where there are fewer


def _grown(array: NDArray[Any], n_wanted: int) -> NDArray[Any]:
    """Return a longer copy, with room to spare."""
    if len(array) >= n_wanted:
        return array
    larger = np.empty((int(_GROWTH * n_wanted), *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger
