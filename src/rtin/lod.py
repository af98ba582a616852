"""Level of detail: meshes of one terrain for any eye, tolerance or budget, from one hierarchy.

A vertex of the lattice that a mesh leaves out stands for all its descendants: the vertices that
have it as an apex, and theirs. For each vertex the hierarchy holds what can go wrong without them:
the largest error of the triangles that would be left, and the box of the samples concerned. Both
are *saturated* (an ancestor's error is never smaller, its box never inside; Lindstrom and Pascucci,
"Terrain simplification simplified", 2002), so a vertex that is wanted has only wanted ancestors:
one walk from the coarsest level down finds a closed set, which is a conforming mesh, in time that
grows with the mesh alone.

The errors themselves are not the accumulated bounds of that paper, but exact maxima over all
samples of a triangle. Each generation's errors are at least ``GROWTH`` times those of the next,
which keeps the *ends* of the edge that a vertex bisects complete before the vertex itself begins
to move: so each vertex moves along one line, and meshes on the way are averages of closed sets.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin import _parallel
from rtin._number import as_number
from rtin._options import (
    MOST,
    as_count,
    as_exaggeration,
    as_height,
    as_zero_or_more,
    the_only_option,
)
from rtin._raster import NO_TRIANGLE
from rtin._tolerance_search import ToleranceSearch, a_bit_finer
from rtin.grid import Grid, as_floats, lattice_size, require_grid, require_heights
from rtin.mesh import TriangleMesh

__all__ = ["Frame", "LevelOfDetail", "as_point", "frustum", "is_compiled"]

GROWTH = 1.03
_ENDS_AHEAD = GROWTH**2  # the ends of an edge are two generations or more before its middle
_ROUNDING = 1.0 + 1e-9
_CENTRE, _EDGE = 0, 3
_FINITE = float(np.finfo(np.float64).max)
_FEWEST_ROWS = 16  # of a generation for a thread: those of large triangles are few but slow
_SPARE = 256  # vertices more than a budget's to walk over

_Floats = NDArray[np.float64]
_Planes = NDArray[np.float64]
_Part = tuple[int, int, int, int]  # first and end row, first and end column or place


@dataclass(frozen=True, eq=False)
class Frame:
    """A mesh for one view, and how far each of its vertices has come from the coarser surface.

    Attributes
    ----------
    mesh : TriangleMesh
        Every vertex at the height of its sample.
    weights : ndarray of float32, shape (n,)
        0 where a vertex lies on the edge that it bisects, 1 where it has its own height. They
        change continuously with the eye and the tolerance, and are 0 where a vertex comes or goes.
    coarser : ndarray of float64, shape (n,)
        The height of the middle of that edge. Its two ends have weight 1. A vertex that tells
        heights from voids, at an outline, does not move: it has its own height here too.
    pixel_error : float
        The tolerance kept, in pixels: the one given, or what the budget allows.
    """

    mesh: TriangleMesh
    weights: NDArray[np.float32]
    coarser: _Floats
    pixel_error: float

    @property
    def morphed(self) -> TriangleMesh:
        """The mesh to draw, in which nothing pops: z = weights * z + (1 - weights) * coarser.

        Its error is within the frame's ``pixel_error``, too.
        """
        vertices = self.mesh.vertices.copy()
        vertices[:, 2] = self.coarser + self.weights * (vertices[:, 2] - self.coarser)
        return TriangleMesh(vertices, self.mesh.triangles, self.mesh.crs)


class _Walk(NamedTuple):
    """Vertices from the coarsest on, and what ``_kernels.lod.walk`` says of each."""

    places: NDArray[np.int32]
    z: _Floats
    around: NDArray[np.int32]
    slots: NDArray[np.uint8]
    weights: _Floats


class _View(NamedTuple):
    """What the walk weighs with: ``eye`` and ``planes`` of ``_kernels.lod.walk``."""

    eye: _Floats
    planes: _Planes


_NO_PLANES = np.empty((0, 4))
_NOBODY = _View(np.zeros(7), _NO_PLANES)


class LevelOfDetail:
    """A hierarchy over a grid, from which meshes for any view are cut in milliseconds.

    Parameters
    ----------
    grid : Grid
        Of any shape, with or without voids. Its heights are not copied before the first update.

    Attributes
    ----------
    grid : Grid
        With the heights as they are now.
    nbytes : int
        Bytes of the hierarchy, about 1.9 times those of float32 heights, but several times those
        of a raster a few samples wide; the heights themselves are not counted.

    Raises
    ------
    TypeError
        If ``grid`` is not a Grid.
    MemoryError
        If the hierarchy does not fit in memory.

    Notes
    -----
    What each vertex stands for is found exactly and then saturated (see the module), so a mesh has
    more vertices than the least one that keeps the same promise, which ``coarsen`` finds in a time
    that grows with the raster: 2 to 7 % more for a tolerance in height, 12 to 16 % for one in
    pixels, and a quarter for a frame, which morphs (Taiwan at 35 m, views of 100 000 triangles).

    Several threads may ask for meshes at once, but not while another one updates.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid: Grid | None = require_grid(grid)
        self._heights = grid.heights
        self._are_heights_own = False
        self._place = (grid.transform, grid.crs)
        self._flip = grid.transform.determinant > 0.0
        self._layout = _layout(grid.shape)
        n_entries, n_owns = _sizes(self._layout)
        try:
            self._own = np.zeros(n_owns, np.float32)
            self._wholes = np.zeros(n_entries, np.uint8)
            self._bounds = np.zeros((n_entries, 3), np.float32)
        except MemoryError:
            raise MemoryError(
                f"a hierarchy over {grid.shape[0]} × {grid.shape[1]} samples needs "
                f"{13 * n_entries / 2**30:.1f} GiB, which can't be had; take a window of the grid"
            ) from None
        self._guesses = [1.0, 1.0]  # tolerances for a budget: of heights, of pixels
        for level, kind in _generations(self._layout):
            _, width, rows = self._layout[level, kind : kind + 3]
            bands_of_rows = _parallel.row_bands(int(rows), fewest=_FEWEST_ROWS)
            bands = [(*band, 0, int(width)) for band in bands_of_rows]
            self._renew(level, kind, (0, grid.shape[0], 0, grid.shape[1]), bands, bands)

    @property
    def grid(self) -> Grid:
        """The grid with the heights as they are now."""
        if self._grid is None:
            self._grid = Grid(self._heights.copy(), *self._place)
        return self._grid

    @property
    def nbytes(self) -> int:
        """Bytes of the hierarchy, without the heights."""
        return self._own.nbytes + self._wholes.nbytes + self._bounds.nbytes + self._layout.nbytes

    def __copy__(self) -> LevelOfDetail:
        return copy.deepcopy(self)  # an update changes arrays in place

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what has been copied or unpickled, whose memory may be somebody else's."""
        self.__dict__.update(state)
        self._heights.flags.writeable = False
        self._are_heights_own = False
        for name in ("_own", "_wholes", "_bounds"):
            setattr(self, name, np.require(getattr(self, name), requirements="W"))

    def mesh(
        self,
        eye: ArrayLike | None = None,
        *,
        pixel_error: float | None = None,
        max_error: float | None = None,
        max_triangles: int | None = None,
        field_of_view: float = 60.0,
        height: int = 1080,
        frustum: ArrayLike | None = None,
        exaggeration: float = 1.0,
    ) -> TriangleMesh:
        """Return a conforming mesh for an eye, or for a tolerance or budget all over.

        Parameters
        ----------
        eye : array_like, shape (3,), optional
            x, y, z, in one unit all three.
        pixel_error : float
            Only with an eye; 1 where nothing else is asked for. *Guaranteed*: every valid sample
            inside the frustum that the mesh covers lies within so many pixels of it. A vertical
            error d at a sample p is ``d / |p - eye| * height / (2 tan(field_of_view / 2))`` pixels:
            those in the middle of a picture turned to that sample. The outline of voids, and of a
            raster that does not fill its lattice, is off sideways by no more than that.
        max_error : float
            Without an eye: every valid sample lies within this vertical distance of its triangle.
            *Guaranteed*; the mesh covers what ``coarsen`` covers.
        max_triangles : int
            The mesh of the smallest ``pixel_error`` or ``max_error`` at which, and at any larger
            one, there are no more triangles. At voids a smaller one may fit as well.
        field_of_view : float
            From the lower to the upper border of the picture, in degrees.
        height : int
            Of the picture, in pixels.
        frustum : array_like, shape (n, 4), optional
            Planes, inside of all of which ``planes[:, :3] @ p + planes[:, 3] >= 0``: outside, the
            mesh is as coarse as can be. ``rtin.frustum`` makes those of a picture.
        exaggeration : float
            The picture shows heights times this, from 1e-6 to 1e6: eye and frustum, distances and
            pixels are those of the terrain as it is drawn. The mesh has its heights unchanged.

        Returns
        -------
        TriangleMesh
            Vertices with the raster's heights unchanged, coarsest first; triangles
            counter-clockwise from above, their hypotenuse first.

        Raises
        ------
        TypeError
            If a number or count is something else.
        ValueError
            If options do not go together, or a number or shape is wrong. With an eye: if the grid
            is in degrees (take ``grid.in_metres()``). Without one: if the budget is too small for
            the outline, or no three samples make a triangle; an eye may see none.
        """
        picture = (field_of_view, height, frustum, exaggeration)
        view, name, value = self._asked(eye, pixel_error, max_error, max_triangles, *picture)
        mesh, _, _ = self._mesh_of(*self._kept(view, name, value))
        if eye is None and mesh.n_triangles == 0:
            raise ValueError(NO_TRIANGLE)
        return mesh

    def frame(
        self,
        eye: ArrayLike,
        *,
        pixel_error: float | None = None,
        max_triangles: int | None = None,
        field_of_view: float = 60.0,
        height: int = 1080,
        frustum: ArrayLike | None = None,
        exaggeration: float = 1.0,
    ) -> Frame:
        """Return a mesh for an eye, with what is needed to move from frame to frame smoothly.

        Parameters as for ``mesh``. A vertex that a move of the eye brings in begins on the surface
        that was there before and has come to its own height where the error it stands for is 6 %
        larger: at that tolerance, the frame's ``pixel_error``, both surfaces keep their promise.
        Frames with one ``max_triangles`` never have more. Nothing is promised outside the frustum,
        and what enters it is at its own height at once.

        Raises
        ------
        TypeError, ValueError
            As ``mesh`` does.
        """
        if eye is None:
            raise ValueError("a frame needs an eye: x, y, z; without one there is mesh(...)")
        picture = (field_of_view, height, frustum, exaggeration)
        view, name, value = self._asked(eye, pixel_error, None, max_triangles, *picture)
        walked, tolerance = self._kept(
            view, name, value / _ENDS_AHEAD if name == "pixel_error" else value
        )
        mesh, coarser, seen = self._mesh_of(walked, tolerance)
        kept = value if name == "pixel_error" else tolerance * _ENDS_AHEAD
        return Frame(mesh, _morph_weights(seen, tolerance), coarser, kept)

    def update(self, rows: slice, cols: slice, heights: ArrayLike) -> None:
        """Change the heights of a patch, and renew the hierarchy where that matters.

        Everything is as if made anew from the changed heights, to the byte. The time grows with
        the patch and the number of levels; large triangles are searched again only where their
        largest error may be. The grid given at first keeps its heights.

        Parameters
        ----------
        rows, cols : slice
            Of samples, without a step.
        heights : array_like, shape (rows of the patch, columns of the patch)
            NaN, or masked, is void. Rounded to the type of the grid's heights.

        Raises
        ------
        TypeError
            If ``rows`` or ``cols`` is no slice, or the heights are no real numbers.
        ValueError
            If the patch is empty, has a step, or is not of the shape of ``heights``; a height is
            too large; or no sample would have one. Nothing is changed then.
        """
        top, bottom = _span("rows", rows, self._heights.shape[0])
        left, right = _span("cols", cols, self._heights.shape[1])
        patch = _as_patch(heights, (bottom - top, right - left), self._heights)
        if np.isnan(patch).all() and not _has_heights_outside(
            self._heights, top, bottom, left, right
        ):
            raise ValueError("heights would hold no value at all: every sample would be NaN")
        if not self._are_heights_own:
            self._heights, self._are_heights_own = self._heights.copy(), True
        self._heights.flags.writeable = True
        self._heights[top:bottom, left:right] = patch
        self._heights.flags.writeable = False  # as a grid's, which kernels are compiled for
        self._grid = None
        changed = (top, bottom, left, right)
        for level, kind in _generations(self._layout):
            near = _near(self._layout, level, kind, changed, 1 << level)
            far = _near(self._layout, level, kind, changed, 3 << level)
            self._renew(level, kind, changed, [near], [far])

    def _renew(
        self,
        level: int,
        kind: int,
        patch: _Part,
        parts: list[_Part],
        parts_of_bounds: list[_Part],
    ) -> None:
        """Renew parts of a generation: own errors where a patch matters, and bounds."""
        from rtin._kernels.hierarchy import renew_bounds, renew_own

        common, found = (self._heights, self._layout), (self._own, self._wholes)
        _parallel.run(renew_own, [(*common, patch, level, kind, *part, *found) for part in parts])
        _parallel.run(
            renew_bounds,
            [
                (*common, GROWTH, level, kind, *part, *found, self._bounds)
                for part in parts_of_bounds
            ],
        )

    def _asked(
        self,
        eye: ArrayLike | None,
        pixel_error: float | None,
        max_error: float | None,
        max_triangles: int | None,
        field_of_view: float,
        height: int,
        frustum: ArrayLike | None,
        exaggeration: float,
    ) -> tuple[_View, str, float]:
        """Return the view, and name and value of the one option given."""
        if eye is None:
            if pixel_error is not None or frustum is not None:
                raise ValueError("pixel_error and frustum need an eye: x, y, z in the grid's unit")
            name, value = the_only_option(max_error=max_error, max_triangles=max_triangles)
            view = _NOBODY
        else:
            if max_error is not None:
                raise ValueError("max_error goes without an eye; with one give pixel_error")
            if max_triangles is None and pixel_error is None:
                pixel_error = 1.0
            name, value = the_only_option(pixel_error=pixel_error, max_triangles=max_triangles)
            view = self._view(eye, field_of_view, height, frustum, exaggeration)
        if name == "max_triangles":
            return view, name, _as_budget(value)
        if name == "pixel_error":
            return view, name, as_zero_or_more(name, value, "in pixels")
        return view, name, as_height(name, value)

    def _view(
        self,
        eye: ArrayLike,
        field_of_view: float,
        height: int,
        frustum: ArrayLike | None,
        exaggeration: float,
    ) -> _View:
        """Return an eye and planes on the lattice.

        Cells so many times as small look as heights so many times as large, from nearer by.
        """
        transform, crs = self._place
        if crs is not None and crs.is_geographic:
            raise ValueError(
                "an eye needs x, y and heights in one unit, but the grid is in degrees: "
                "take LevelOfDetail(grid.in_metres())"
            )
        pixels = as_number("height", height)
        if not 0.0 < pixels < math.inf:
            raise ValueError(f"height must be a positive number of pixels, got {height!r}")
        scale = _ROUNDING * pixels / 2.0 / _half_tangent(field_of_view)
        if not 0.0 < scale < math.inf:
            raise ValueError(
                f"height must be pixels of a picture of {field_of_view} degrees, got {height!r}"
            )
        x, y, z = as_point("eye", eye)
        times = as_exaggeration(exaggeration)
        a, b, x0, d, e, y0 = tuple(transform)[:6]
        axes = np.array([[b, a], [e, d]])  # x, y of a step along a column, and along a row
        row, col = np.linalg.solve(axes, (x - x0, y - y0))
        place = np.array([row, col, z / times, *_lengths(axes / times), scale])
        if frustum is None:
            return _View(place, _NO_PLANES)
        planes = _as_planes(frustum)
        offsets = planes[:, 3] + planes[:, 0] * x0 + planes[:, 1] * y0
        slopes = planes[:, :2] @ axes
        return _View(place, np.column_stack([slopes, times * planes[:, 2], offsets]))

    def _walk(self, view: _View, tolerance: float, most: int) -> _Walk:
        from rtin._kernels.lod import walk

        return _Walk(*walk(self._heights, self._layout, self._bounds, *view, tolerance, most))

    def _kept(self, view: _View, name: str, value: float) -> tuple[_Walk, float]:
        """Return a walk and the tolerance above which its vertices are kept."""
        if name == "max_triangles":
            return self._within_budget(view, int(value))
        tolerance = min(value, _FINITE)  # what outlines need weighs more than any
        return self._walk(view, tolerance, MOST), tolerance

    def _within_budget(self, view: _View, budget: int) -> tuple[_Walk, float]:
        """Return a walk, and the tolerance at which it makes no more triangles than a budget.

        The walk goes on from the last one's tolerance, which changes nothing but the time.
        """
        from rtin._kernels.lod import tolerance_within

        has_eye = view is not _NOBODY
        search = ToleranceSearch(self._guesses[has_eye])
        most = min(2 * budget + _SPARE, MOST)
        while True:
            walked = self._walk(view, search.tolerance, MOST if search.is_narrow else most)
            corners = _Walk._make(of_all[:4] for of_all in walked)
            n_coarsest = len(self._triangles(corners, math.inf))
            tolerance = tolerance_within(*walked[1:], n_coarsest, budget)
            if len(walked.weights) > most and not search.is_narrow:
                search.go_coarser(tolerance)
                continue
            if tolerance >= 0.0 or search.tolerance == 0.0:
                break
            search.go_finer(len(walked.weights), budget / 2)
        tolerance = max(tolerance, 0.0)
        if math.isfinite(tolerance):
            self._guesses[has_eye] = a_bit_finer(tolerance)
        elif not has_eye:
            least = len(self._triangles(walked, _FINITE))
            raise ValueError(
                f"max_triangles must be at least {least} for this outline, got {budget}"
            )
        return walked, tolerance

    def _triangles(self, walked: _Walk, tolerance: float) -> NDArray[np.int32]:
        """Return the triangles of the vertices above a tolerance, numbered as in the walk."""
        from rtin._kernels.lod import triangles_of

        return np.asarray(triangles_of(*walked, tolerance, self._flip))

    def _mesh_of(self, walked: _Walk, tolerance: float) -> tuple[TriangleMesh, _Floats, _Floats]:
        """Return the mesh of a tolerance, what it morphs from, and what its vertices weigh."""
        from rtin._kernels.lod import fill_vertices, renumber

        triangles = self._triangles(walked, tolerance)
        numbers = renumber(triangles, len(walked.weights))
        vertices, coarser = np.empty((len(numbers), 3)), np.empty(len(numbers))
        transform, crs = self._place
        numbers_of_transform = np.array(tuple(transform)[:6], np.float64)
        fill_vertices(numbers_of_transform, *walked[:4], numbers, vertices, coarser)
        return TriangleMesh(vertices, triangles, crs), coarser, walked.weights[numbers]


def is_compiled() -> bool:
    """Return whether compiled kernels lie on disk: the first call on a machine takes longer."""
    from rtin._kernels._jit import compiled_before
    from rtin._kernels.lod import walk

    return compiled_before(walk)


def frustum(
    eye: ArrayLike,
    target: ArrayLike,
    *,
    field_of_view: float = 60.0,
    aspect: float = 16.0 / 9.0,
    up: ArrayLike = (0.0, 0.0, 1.0),
) -> _Planes:
    """Return the planes of what a picture shows: its four sides, and the plane of the eye itself.

    Parameters
    ----------
    eye, target : array_like, shape (3,)
        Where the eye is, and a point in the middle of the picture.
    field_of_view : float
        From the lower to the upper border, in degrees.
    aspect : float
        Width by height of the picture.
    up : array_like, shape (3,)
        A direction that is up in the picture.

    Returns
    -------
    ndarray of float64, shape (5, 4)
        Left, right, bottom, top, eye. A point p is inside where
        ``planes[:, :3] @ p + planes[:, 3] >= 0`` for all five. The normals have length 1.

    Raises
    ------
    TypeError
        If a number is none.
    ValueError
        If a point is not three finite numbers, eye and target are one, ``up`` runs along the line
        between them, or an angle or aspect is impossible.
    """
    place = as_point("eye", eye)
    forward = as_point("target", target) - place
    tangent = _half_tangent(field_of_view)
    across = as_number("aspect", aspect)
    if not 0.0 < across < math.inf:
        raise ValueError(f"aspect must be positive, width by height, got {aspect!r}")
    if not np.any(forward):
        raise ValueError(f"eye and target must be two points, both are {place.tolist()}")
    forward = _direction(forward)
    right = np.cross(forward, _direction(as_point("up", up)))
    if not np.linalg.norm(right) > 1e-12:
        raise ValueError(
            "up must not run along the line from eye to target; give another direction"
        )
    right = _direction(right)
    above = np.cross(right, forward)
    normals = np.array([
        _direction(tangent * across * forward + right),
        _direction(tangent * across * forward - right),
        _direction(tangent * forward + above),
        _direction(tangent * forward - above),
        forward,
    ])  # fmt: skip
    return np.column_stack([normals, -normals @ place])


def _direction(vector: _Floats) -> _Floats:
    """Return a vector of length 1; one of zeros as it is. Squares of its parts may not overflow."""
    largest = np.abs(vector).max()
    if largest == 0.0:
        return vector
    scaled = vector / largest
    return np.asarray(scaled / np.linalg.norm(scaled))


# --- the hierarchy --------------------------------------------------------------------------------


def _layout(shape: tuple[int, int]) -> NDArray[np.int64]:
    """Return where each generation is kept, as ``_kernels.hierarchy`` says: coarsest first."""
    size = lattice_size(shape)
    n_levels = size.bit_length() - 1
    layout = np.zeros((n_levels, 6), np.int64)
    first = 0
    for level in reversed(range(n_levels)):
        spacing = 1 << level
        # Farther outside the raster no vertex has a descendant with a sample.
        rows, cols = (length - 3 + 2 * spacing for length in shape)
        n_cells = size // (2 * spacing)
        width, height = (min(n_cells, beyond // (2 * spacing) + 1) for beyond in (cols, rows))
        layout[level, :3] = first, width, height
        first += width * height
        width = min(n_cells + 1, cols // (2 * spacing) + 1)
        height = min(2 * n_cells + 1, rows // spacing + 1)
        layout[level, 3:] = first, width, height
        first += width * height
    return layout


def _sizes(layout: NDArray[np.int64]) -> tuple[int, int]:
    """Return the number of entries in all, and of those that keep their own errors."""
    if len(layout) == 0:
        return 0, 0
    first, width, height = layout[0, :3].tolist()
    return first + width * height, first


def _generations(layout: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return level and kind of the generations kept, finest first."""
    return [(level, kind) for level in range(len(layout)) for kind in (_EDGE, _CENTRE)][1:]


def _near(layout: NDArray[np.int64], level: int, kind: int, patch: _Part, reach: int) -> _Part:
    """Return the rows and places of a generation within reach of a patch, and a few more."""
    top, bottom, left, right = patch
    shift = level + 1 if kind == _CENTRE else level
    _, width, n_rows = layout[level, kind : kind + 3].tolist()
    return (
        max((top - reach) >> shift, 0),
        min(((bottom + reach) >> shift) + 1, n_rows),
        max((left - reach) >> (level + 1), 0),
        min(((right + reach) >> (level + 1)) + 1, width),
    )


def _lengths(axes: _Floats) -> tuple[float, float, float]:
    """Return what a row and a column are long on the ground, at least; what either is, at most."""
    along_col, along_row = axes.T
    row, col = float(np.linalg.norm(along_col)), float(np.linalg.norm(along_row))
    if abs(along_col @ along_row) <= 1e-9 * row * col:
        return row, col, max(row, col)
    least = float(np.linalg.svd(axes, compute_uv=False)[-1])
    return least, least, row + col


def _morph_weights(seen: _Floats, tolerance: float) -> NDArray[np.float32]:
    if tolerance == 0.0:
        return np.ones(len(seen), np.float32)
    with np.errstate(invalid="ignore"):  # inf: seen from inside its box
        come = (seen / tolerance - 1.0) / (_ENDS_AHEAD - 1.0)
    return np.nan_to_num(np.clip(come, 0.0, 1.0), nan=1.0).astype(np.float32)


# --- the door -------------------------------------------------------------------------------------


def _as_array(value: ArrayLike) -> NDArray[Any]:
    """Return an array; one of objects where rows are not of one length."""
    try:
        return np.asarray(value)
    except ValueError:
        return np.asarray(value, object)


def as_point(name: str, value: ArrayLike) -> _Floats:
    """Return x, y, z; raise ValueError for anything but three finite numbers."""
    point = _as_array(value)
    if point.dtype.kind not in "fiu" or point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"{name} must be three finite numbers, x, y, z; got {value!r}")
    return point.astype(np.float64)


def _as_planes(value: ArrayLike) -> _Planes:
    planes = _as_array(value)
    if planes.dtype.kind not in "fiu" or planes.ndim != 2 or planes.shape[1] != 4:
        raise ValueError(
            f"frustum must be planes, numbers of shape (n, 4), got shape {planes.shape}; "
            "rtin.frustum(eye, target) makes them"
        )
    if not np.isfinite(planes).all():
        raise ValueError("frustum must hold finite numbers only")
    return planes.astype(np.float64)


def _half_tangent(degrees: float) -> float:
    """Return half the height of a picture at a distance of 1."""
    angle = as_number("field_of_view", degrees)
    tangent = math.tan(math.radians(angle) / 2.0) if 0.0 < angle < 180.0 else 0.0
    if tangent == 0.0:
        raise ValueError(f"field_of_view must be between 0 and 180 degrees, got {degrees!r}")
    return tangent


def _as_budget(value: int) -> int:
    budget = as_count("max_triangles", value)
    if budget < 2:
        raise ValueError(f"max_triangles must be at least 2, got {value}")
    return budget


def _span(name: str, value: slice, n: int) -> tuple[int, int]:
    if not isinstance(value, slice):
        raise TypeError(f"{name} must be a slice, got {value!r}")
    try:
        first, end, step = value.indices(n)
    except TypeError:
        raise TypeError(f"{name} must be a slice of whole numbers, got {value!r}") from None
    if step != 1 or first >= end:
        raise ValueError(f"{name} must be some of 0 to {n}, without a step; got {value!r}")
    return first, end


def _as_patch(
    values: ArrayLike, shape: tuple[int, int], heights: NDArray[np.floating[Any]]
) -> NDArray[np.floating[Any]]:
    if np.shape(values) != shape:
        raise ValueError(
            f"heights must have the patch's shape {shape} in a raster of {heights.shape}, "
            f"got {np.shape(values)}"
        )
    patch = require_heights(as_floats(values))
    with np.errstate(over="ignore"):
        rounded = patch.astype(heights.dtype)
    if np.isinf(rounded).any():
        raise ValueError(
            f"heights must fit the grid's {heights.dtype}, got {np.nanmax(np.abs(patch)):g}; "
            "make the LevelOfDetail of a float64 grid"
        )
    return rounded


def _has_heights_outside(
    heights: NDArray[np.floating[Any]], top: int, bottom: int, left: int, right: int
) -> bool:
    beside = heights[top:bottom, :left], heights[top:bottom, right:]
    parts = heights[:top], heights[bottom:], *beside
    return any(not np.isnan(row).all() for part in parts for row in part)
