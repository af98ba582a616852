"""Other people's simplifiers behind one interface, to compare meshes of a terrain with.

Each is its own library's work, with that library's defaults unless a line below says otherwise, and
is asked for a number of vertices or for a largest vertical error. ``SIMPLIFIERS`` lists them. Those
that are not installed raise ``NotInstalled``, those that can't take a grid ``NotSuited``; whoever
compares passes over both with a note.

What they hand back is put in the grid's coordinates and nothing else is mended: ``compared`` says
how much of the raster a mesh leaves uncovered and what else is wrong with it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtin import validity
from rtin._distinct import distinct
from rtin._merging import merge_flat
from rtin._options import as_height, the_only_option
from rtin.coarsening import coarsen
from rtin.criteria import vertical_error
from rtin.grid import Grid, require_grid
from rtin.io import _gltf
from rtin.io._placement import Placement, place, placement
from rtin.mesh import TriangleMesh

__all__ = [
    "SIMPLIFIERS",
    "Compared",
    "NotInstalled",
    "NotSuited",
    "Simplified",
    "Simplifier",
    "compared",
    "full_mesh",
    "simplified",
    "simplify",
]

_NEAR = 0.005  # of a count: nearer to it a slow search does not go
_MOST_RUNS = 60  # of a search
_NO_AREA = 1e-6  # of a cell
_ROUNDED = 1e-4  # of a cell: what VTK's 32-bit coordinates may be off


class NotInstalled(ImportError):  # noqa: N818  (a state, as in the message)
    """A simplifier's library is not there; the message names the package to install."""


class NotSuited(ValueError):  # noqa: N818
    """A simplifier can't take this grid, or can't do what is asked of it with this grid."""


class _Surface(NamedTuple):
    """What a foreign library made, in the grid's coordinates, in its own order."""

    vertices: NDArray[np.float64]
    triangles: NDArray[Any]


_Made = TriangleMesh | _Surface
_Run = Callable[[Any], _Made]
_Knob = Literal["max_error", "tolerance", "max_vertices", "max_triangles", "step"]


@dataclass(frozen=True)
class Simplifier:
    """What there is to know of one simplifier.

    Attributes
    ----------
    label : str
        Its name for people.
    driven_by : "error", "vertices", "triangles" or "step"
        What it is told itself; anything else is searched for.
    description : str
        One line.
    package : str or None
        What pip has to install, if that does not come with rtin.
    """

    label: str
    driven_by: Literal["error", "vertices", "triangles", "step"]
    description: str
    package: str | None
    _begin: Callable[[Grid], dict[_Knob, _Run]]


class Simplified(NamedTuple):
    """A simplified mesh and how it came about.

    Attributes
    ----------
    mesh : TriangleMesh
    knob : str
        What the simplifier was told: max_error, tolerance, max_vertices, max_triangles or step.
    setting : float
        The value of that.
    seconds : float
        Of the last run at that setting; neither a search for it nor what has to be done once for a
        grid (its full triangulation, martini's tables) counts.
    """

    mesh: TriangleMesh
    knob: str
    setting: float
    seconds: float


def simplify(
    grid: Grid, name: str, *, max_error: float | None = None, max_vertices: int | None = None
) -> TriangleMesh:
    """Return the mesh that a simplifier makes of a grid; exactly one of the options says how far.

    Parameters
    ----------
    grid : Grid
    name : str
        One of ``SIMPLIFIERS``.
    max_error : float
        In the unit of the heights. "rtin" and "delatin" take it themselves (delatin's heights are
        32-bit: it may be exceeded by their rounding). For all others the coarsest setting is
        searched at which ``vertical_error(mesh, grid).max`` is not larger. The error does not grow
        steadily with their settings, so that the search, by bisection, may miss a coarser mesh that
        would do. It holds at the samples that the mesh covers.
    max_vertices : int
        Never exceeded. "rtin", "delatin" and "angle-merge" take it themselves; for the others the
        finest setting that fits is searched. Those driven by a tolerance come as near as their
        meshes allow, those driven by triangles to within half a percent.

    Returns
    -------
    TriangleMesh
        In the coordinates and the CRS of the grid; every vertex has a triangle, triangles look up
        and have an area in the xy plane. Foreign meshes may still be wrong: folded, or short of the
        raster's border.

    Raises
    ------
    NotInstalled
        If the library is not there.
    NotSuited
        If it can't take the grid (voids, a shape) or can't get so far down.
    TypeError, ValueError
        If ``grid`` is not a Grid, the name is unknown, or not exactly one option is given.
    """
    return simplified(grid, name, max_error=max_error, max_vertices=max_vertices).mesh


def simplified(
    grid: Grid, name: str, *, max_error: float | None = None, max_vertices: int | None = None
) -> Simplified:
    """Return what ``simplify`` does, with the setting that was found and the seconds it took."""
    require_grid(grid)
    if name not in SIMPLIFIERS:
        raise ValueError(f"a simplifier is one of {', '.join(SIMPLIFIERS)}, got {name!r}")
    option, value = the_only_option(max_error=max_error, max_vertices=max_vertices)
    knob: _Knob = "max_error" if option == "max_error" else "max_vertices"
    height = as_height(option, value) if option == "max_error" else 0.0
    count = _as_count(value) if option == "max_vertices" else 0
    runs = SIMPLIFIERS[name]._begin(grid)
    if knob in runs:
        return _timed(grid, knob, runs[knob], count or height)
    search = _Search(grid, name, *next(iter(runs.items())))
    return search.within_count(count) if count else search.within_error(height)


def _as_count(value: Any) -> int:  # noqa: ANN401
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"max_vertices must be a whole number, got {value!r}")
    if value < 4:
        raise ValueError(f"max_vertices must be at least 4, got {value}")
    return int(value)


def full_mesh(grid: Grid) -> TriangleMesh:
    """Return all the finest triangles of a grid, those without three heights left out."""
    return coarsen(grid, removable=np.zeros(grid.shape, np.bool_))


# --- searches -----------------------------------------------------------------------------------


class _Settings(NamedTuple):
    """What a knob can be set to, from the finest mesh to the coarsest."""

    finest: float
    coarsest: float
    between: Callable[[float, float], float]
    are_close: Callable[[float, float], bool]


def _settings(grid: Grid, knob: _Knob) -> _Settings:
    rows, cols = grid.shape
    if knob == "tolerance":
        relief = float(np.nanmax(grid.heights)) - float(np.nanmin(grid.heights))
        return _Settings(
            0.0, 2.0 * relief + 1.0,
            between=lambda one, other: 0.5 * (one + other),
            are_close=lambda one, other: abs(one - other) <= 1e-9 * (relief + 1.0),
        )  # fmt: skip
    if knob == "step":
        return _Settings(1, max(rows, cols) - 1, lambda a, b: int(a + b) // 2, _are_neighbours)
    most = rows * cols if knob == "max_vertices" else 2 * (rows - 1) * (cols - 1)
    least = 4 if knob == "max_vertices" else 2
    # Counts that differ by a factor are alike, hence the geometric mean.
    return _Settings(most, least, lambda a, b: math.isqrt(int(a) * int(b)), _are_neighbours)


def _are_neighbours(one: float, other: float) -> bool:
    return abs(one - other) <= 1


class _Search(NamedTuple):
    """One simplifier on one grid, whose setting is searched by bisection."""

    grid: Grid
    name: str
    knob: _Knob
    run: _Run

    def at(self, setting: float) -> Simplified:
        return _timed(self.grid, self.knob, self.run, setting)

    def within_count(self, limit: int) -> Simplified:
        """Return the finest mesh found that has not more vertices than the limit."""
        fine, coarse, between, are_close = _settings(self.grid, self.knob)
        if limit >= self.grid.n_samples:
            return self.at(fine)
        best, enough = None, limit
        setting = between(fine, coarse)
        if self.knob == "max_triangles":
            enough = math.ceil((1.0 - _NEAR) * limit)
            setting = min(fine, max(coarse, _triangles_of(limit)))
        for _ in range(_MOST_RUNS):
            found = self.at(setting)
            count = found.mesh.n_vertices
            if count > limit:
                fine = setting
            else:
                coarse = setting
                best = found if best is None or count > best.mesh.n_vertices else best
            if enough <= count <= limit or are_close(fine, coarse):
                break
            setting = between(fine, coarse)
            secant = found.setting - 2 * (count - limit)  # a vertex is worth two triangles
            if self.knob == "max_triangles" and coarse < secant < fine:
                setting = secant
        best = best or self._coarsest(limit)
        if best.mesh.n_triangles == 0:
            raise NotSuited(f"{self.name} leaves nothing of this grid, got max_vertices={limit}")
        return best

    def _coarsest(self, limit: int) -> Simplified:
        found = self.at(_settings(self.grid, self.knob).coarsest)
        if found.mesh.n_vertices > limit:
            raise NotSuited(
                f"{self.name} does not get below {found.mesh.n_vertices} vertices on this grid, "
                f"got max_vertices={limit}"
            )
        return found

    def within_error(self, limit: float) -> Simplified:
        """Return the coarsest mesh found whose vertical error is not above the limit."""
        fine, coarse, between, are_close = _settings(self.grid, self.knob)
        best, setting = self.at(fine), coarse
        if self._error_of(best) > limit:
            raise NotSuited(
                f"{self.name} gets no nearer to this grid than {self._error_of(best):g}"
            )
        is_count = self.knob in ("max_triangles", "max_vertices")
        for _ in range(_MOST_RUNS):
            found = self.at(setting)
            if self._error_of(found) <= limit:
                fine, best = setting, found
            else:
                coarse = setting
            if are_close(fine, coarse) or (is_count and fine - coarse <= _NEAR * fine):
                break
            setting = between(fine, coarse)
        return best

    def _error_of(self, found: Simplified) -> float:
        try:
            return vertical_error(found.mesh, self.grid).max
        except ValueError:  # no sample is covered
            return math.inf


def _triangles_of(n_vertices: int) -> int:
    """Return how many triangles a mesh of a square has, if its vertices are spread evenly.

    By Euler's formula, with half as many vertices on the border as that would give.
    """
    return int(2.0 * (n_vertices - math.sqrt(n_vertices)))


def _timed(grid: Grid, knob: _Knob, run: _Run, setting: float) -> Simplified:
    started = time.perf_counter()
    made = run(setting)
    seconds = time.perf_counter() - started
    mesh = made if isinstance(made, TriangleMesh) else _tidied(made, grid)
    return Simplified(mesh, knob, setting, seconds)


def _tidied(made: _Surface, grid: Grid) -> TriangleMesh:
    """Return a mesh without triangles that have no area from above, nor vertices without any."""
    corners = np.asarray(made.triangles, np.int64).reshape(-1, 3)
    turned = TriangleMesh.from_triangles(made.vertices, corners)
    triangles = turned.triangles[turned.signed_areas() > _NO_AREA * abs(grid.transform.determinant)]
    used = distinct(triangles.ravel().astype(np.int64))
    return TriangleMesh(made.vertices[used], np.searchsorted(used, triangles), grid.crs)


# --- the simplifiers ----------------------------------------------------------------------------


def _rtin(grid: Grid) -> dict[_Knob, _Run]:
    for options in ({"max_error": 0.0}, {"max_vertices": 4}):  # compiling is none of the work
        coarsen(Grid(np.zeros((2, 2), grid.heights.dtype)), **options)

    def within(count: int) -> TriangleMesh:
        try:
            return coarsen(grid, max_vertices=count)
        except ValueError as reason:
            raise NotSuited(str(reason)) from None

    return {"max_error": lambda height: coarsen(grid, max_error=height), "max_vertices": within}


def _threshold(grid: Grid) -> dict[_Knob, _Run]:
    return {"tolerance": lambda height: coarsen(grid, threshold=height)}


def _martini(grid: Grid) -> dict[_Knob, _Run]:
    martini = _library("pymartini", "pymartini")
    _require_whole(grid, "martini")
    rows, cols = grid.shape
    if rows != cols or (rows - 1) & (rows - 2) or rows < 3:
        raise NotSuited(f"martini takes squares of 2**k + 1 samples a side, got {rows} × {cols}")
    tables, heights = martini.Martini(rows), grid.heights.astype(np.float32).ravel()

    def run(tolerance: float) -> _Surface:
        places, triangles = tables.create_tile(heights).get_mesh(tolerance)
        col, row = np.asarray(places).reshape(-1, 2).T.astype(np.intp)
        return _at_samples(grid, row, col, np.asarray(triangles))

    return {"tolerance": run}


def _delatin(grid: Grid) -> dict[_Knob, _Run]:
    delatin = _library("pydelatin", "pydelatin")
    _require_whole(grid, "delatin")
    heights = grid.heights.astype(np.float32)

    def run(**options: Any) -> _Surface:  # noqa: ANN401
        tin = delatin.Delatin(heights, **options)
        col, from_south = tin.vertices[:, :2].T.astype(np.intp)
        return _at_samples(grid, grid.shape[0] - 1 - from_south, col, tin.triangles)

    return {
        "max_error": lambda height: run(max_error=height),
        "max_vertices": lambda count: run(max_error=0.0, max_points=count),
    }


def _subsample(grid: Grid) -> dict[_Knob, _Run]:
    def run(step: int) -> _Surface:
        rows, cols = (np.append(np.arange(0, n - 1, step), n - 1) for n in grid.shape)
        row, col = (values.ravel() for values in np.meshgrid(rows, cols, indexing="ij"))
        triangles = _checkerboard(len(rows), len(cols))
        valid = ~np.isnan(grid.heights[row, col])
        return _at_samples(grid, row, col, triangles[valid[triangles].all(axis=1)])

    return {"step": run}


def _checkerboard(n_rows: int, n_cols: int) -> NDArray[np.int64]:
    """Return two triangles for each cell of a lattice, diagonals alternating."""
    row, col = (values.ravel() for values in np.indices((n_rows - 1, n_cols - 1)))
    north_west = row * n_cols + col
    north_east, south_west, south_east = (north_west + shift for shift in (1, n_cols, n_cols + 1))
    odd = ((row + col) % 2 == 1)[:, np.newaxis]
    one = np.column_stack([north_west, south_west, south_east])
    other = np.column_stack([north_west, south_east, north_east])
    one_of_odd = np.column_stack([north_west, south_west, north_east])
    other_of_odd = np.column_stack([north_east, south_west, south_east])
    return np.concatenate([np.where(odd, one_of_odd, one), np.where(odd, other_of_odd, other)])


def _angle_merge(grid: Grid) -> dict[_Knob, _Run]:
    _library("scipy", "scipy")
    _require_whole(grid, "angle-merge")
    solid = _Solid.of(grid)
    rows, cols = grid.shape
    east, south = solid.cell(grid)
    row, col = (values.ravel() for values in np.indices(grid.shape))
    # On the lattice itself, so that the sides stay straight whatever the rotation.
    points = np.column_stack([east * col, -south * row, grid.heights[row, col]])
    triangles = _checkerboard(rows, cols).astype(np.int32)

    def run(count: int) -> _Surface:
        merged, made = merge_flat(points, triangles, count)
        col, row, z = merged[:, 0] / east, merged[:, 1] / -south, merged[:, 2]
        return _Surface(_world(grid, row, col, z), made)

    return {"max_vertices": run}


def _quadric(grid: Grid) -> dict[_Knob, _Run]:
    library = _library("fast_simplification", "fast-simplification")
    solid = _Solid.of(grid)
    # Its passes have fixed tolerances, up to some that kilometres between samples would be beyond.
    unit = math.sqrt(math.prod(solid.cell(grid)))
    scaled = solid.points / unit

    def run(count: int) -> _Surface:
        points, triangles = library.simplify(scaled, solid.triangles, target_count=count)
        return _Surface(solid.placement.to_world(points * unit), triangles)

    return {"max_triangles": solid.unless_all(run)}


def _vtk_quadric(grid: Grid) -> dict[_Knob, _Run]:
    solid = _Solid.of(grid)
    surface = _poly_data(solid)

    def run(count: int) -> _Surface:
        return _from_vtk(grid, solid, surface.decimate(1.0 - count / len(solid.triangles)))

    return {"max_triangles": solid.unless_all(run)}


def _decimate_pro(grid: Grid) -> dict[_Knob, _Run]:
    solid = _Solid.of(grid)
    surface = _poly_data(solid)

    def run(count: int) -> _Surface:
        # Otherwise edges sharper than 45°, many in the mountains, are taken for features.
        made = surface.decimate_pro(
            1.0 - count / len(solid.triangles),
            feature_angle=180.0, splitting=False, preserve_topology=True,
        )  # fmt: skip
        return _from_vtk(grid, solid, made)

    return {"max_triangles": solid.unless_all(run)}


def _meshoptimizer(grid: Grid) -> dict[_Knob, _Run]:
    library = _library("meshoptimizer", "meshoptimizer")
    solid = _Solid.of(grid)
    indices, points = solid.triangles.ravel().astype(np.uint32), solid.points.astype(np.float32)

    def run(count: int) -> _Surface:
        kept = np.empty_like(indices)
        n_indices = library.simplify(
            kept, indices, points, target_index_count=3 * count, target_error=1e9
        )
        return _Surface(solid.vertices, kept[:n_indices])

    return {"max_triangles": solid.unless_all(run)}


# Names for programs and the command line, in the order of the tables.
SIMPLIFIERS: dict[str, Simplifier] = {
    "rtin": Simplifier(
        "least RTIN", "error",
        "coarsen(max_error=): the least right-triangulated mesh within the error", None, _rtin,
    ),
    "threshold": Simplifier(
        "RTIN-Coarsening", "error",
        "coarsen(threshold=): the paper's Eq. (1), which bounds no surface", None, _threshold,
    ),
    "martini": Simplifier(
        "martini", "error",
        "pymartini's right-triangulated mesh, by errors accumulated over levels",
        "pymartini", _martini,
    ),
    "delatin": Simplifier(
        "delatin", "error",
        "pydelatin: Delaunay triangles, the worst sample inserted until all are within the error",
        "pydelatin", _delatin,
    ),
    "quadric": Simplifier(
        "fast-simplification", "triangles",
        "edges collapsed by quadric error, in passes of growing tolerance; the border gives way",
        "fast-simplification", _quadric,
    ),
    "vtk-quadric": Simplifier(
        "VTK quadric", "triangles",
        "vtkQuadricDecimation: edges collapsed by quadric error, the cheapest first",
        "pyvista", _vtk_quadric,
    ),
    "meshoptimizer": Simplifier(
        "meshoptimizer", "triangles",
        "edges collapsed to one of their ends by quadric error", "meshoptimizer", _meshoptimizer,
    ),
    "decimate-pro": Simplifier(
        "VTK DecimatePro", "triangles",
        "vtkDecimatePro: vertices removed by their distance to the plane of those around",
        "pyvista", _decimate_pro,
    ),
    "subsample": Simplifier(
        "subsampling", "step",
        "every n-th row and column, and the last ones", None, _subsample,
    ),
    "angle-merge": Simplifier(
        "angle merging", "vertices",
        "vertices merged where normals differ least, then Delaunay: in place of Rational Reducer",
        "scipy", _angle_merge,
    ),
}  # fmt: skip


# --- what they need -----------------------------------------------------------------------------


def _library(module: str, package: str) -> Any:  # noqa: ANN401
    try:
        return import_module(module)
    except ImportError as error:
        raise NotInstalled(f"{package} is not installed: pip install {package}") from error


def _require_whole(grid: Grid, name: str) -> None:
    if grid.has_voids:
        raise NotSuited(f"{name} takes no samples without a height; cut a window without voids")


def _at_samples(
    grid: Grid, row: NDArray[np.intp], col: NDArray[np.intp], triangles: NDArray[Any]
) -> _Surface:
    """Return triangles over samples, with the raster's own heights."""
    return _Surface(_world(grid, row, col, grid.heights[row, col]), triangles)


def _world(
    grid: Grid, row: NDArray[Any], col: NDArray[Any], z: NDArray[Any]
) -> NDArray[np.float64]:
    a, b, x0, d, e, y0 = tuple(grid.transform)[:6]
    return np.column_stack([a * col + b * row + x0, d * col + e * row + y0, z]).astype(np.float64)


class _Solid(NamedTuple):
    """A grid's full triangulation for methods that measure in space: one unit for x, y and z.

    Degrees become metres as when a mesh is written, and x and y count from the middle, so that
    32-bit coordinates do.
    """

    vertices: NDArray[np.float64]
    points: NDArray[np.float64]
    triangles: NDArray[np.int32]
    placement: Placement

    @classmethod
    def of(cls, grid: Grid) -> _Solid:
        mesh = full_mesh(grid)
        placed = placement(mesh, centred=True)
        # Copies, because some libraries want arrays that they could write to.
        return cls(mesh.vertices, placed.to_file(mesh.vertices), mesh.triangles.copy(), placed)

    def cell(self, grid: Grid) -> tuple[float, float]:
        """Return the lengths of a cell's sides along a row and along a column."""
        a, b, _, d, e, _ = tuple(grid.transform)[:6]
        east, north, _ = self.placement.scale
        return math.hypot(a * east, d * north), math.hypot(b * east, e * north)

    def unless_all(self, run: _Run) -> _Run:
        """Return ``run``, but all triangles as they are where as many are asked for."""
        everything = _Surface(self.vertices, self.triangles)
        return lambda count: everything if count >= len(self.triangles) else run(count)


def _poly_data(solid: _Solid) -> Any:  # noqa: ANN401
    pyvista = _library("pyvista", "pyvista")
    return pyvista.PolyData.from_regular_faces(solid.points, solid.triangles)


def _from_vtk(grid: Grid, solid: _Solid, made: Any) -> _Surface:  # noqa: ANN401
    """Return what VTK made of a grid; on nearly flat terrain some triangles lack a corner."""
    vertices = solid.placement.to_world(np.asarray(made.points, np.float64))
    triangles = made.regular_faces
    return _Surface(_unrounded(grid, vertices), triangles[(triangles >= 0).all(axis=1)])


def _unrounded(grid: Grid, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vertices put back on the rows and columns that VTK's 32 bits rounded them off."""
    places = grid.places(vertices[:, :2])
    nearest = np.rint(places)
    row, col = np.where(np.abs(places - nearest) < _ROUNDED, nearest, places).T
    return _world(grid, row, col, vertices[:, 2])


# --- what came out ------------------------------------------------------------------------------


class Compared(NamedTuple):
    """A simplified mesh, measured against its grid; lengths in the unit of the heights.

    Attributes
    ----------
    name : str
        Of the simplifier.
    n_vertices, n_triangles : int
    n_bytes : int
        As a GLB.
    max, rms, mean : float
        Of the vertical error at the samples that the mesh covers.
    n_uncovered : int
        Samples that it does not cover.
    faults : tuple of str
        What ``validity.complaints`` says of the mesh.
    seconds : float
        Of the simplification alone.
    """

    name: str
    n_vertices: int
    n_triangles: int
    n_bytes: int
    max: float
    rms: float
    mean: float
    n_uncovered: int
    faults: tuple[str, ...]
    seconds: float


def compared(grid: Grid, name: str, made: Simplified) -> Compared:
    """Return the figures of a simplified mesh.

    Raises
    ------
    ValueError
        If the mesh covers no sample.
    """
    error = vertical_error(made.mesh, grid)
    placed = place(made.mesh, placement(made.mesh), None)
    return Compared(
        name=name,
        n_vertices=made.mesh.n_vertices,
        n_triangles=made.mesh.n_triangles,
        n_bytes=len(_gltf.glb(placed)),
        max=error.max,
        rms=error.rms,
        mean=error.mean,
        n_uncovered=error.n_uncovered,
        faults=tuple(validity.complaints(made.mesh)),
        seconds=made.seconds,
    )
