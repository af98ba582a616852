"""Jobs: of which rasters tiles are made, at which zooms and tolerances, in which format."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import atan, degrees, isinf, pi, sinh, sqrt
from typing import Any, Literal

import numpy as np

from rtin._options import as_zero_or_more, require_word
from rtin.grid import lattice_size
from rtin.io.tileset import Format, Summary, write_tileset
from rtin.pyramid import Plan, geometric_error, tolerances
from rtin.schemes import EQUATORIAL_RADIUS, SCHEMES, Scheme
from rtin.tiles import HeightLattice, require_cells

__all__ = ["TileJob", "raster_tiles", "world_tiles"]

_CELLS_OF_WORLD = 64  # as CesiumJS takes terrain to have
_CELLS_OF_RASTER = 1024
_DEEPEST = 24
_ABOUT = ("name", "description", "attribution", "version")
# Of the tolerance: 15 bits of height within a tile take less, as a rule, and 24 bits much less.
_ROUNDING = {"terrain": 1.0 / 32.0, "3dtiles": 1.0 / 256.0}
_PIXELS = 0.5  # of error, for each pixel that CesiumJS lets terrain be off

Zooms = tuple[int | None, int | None]


@dataclass(frozen=True)
class TileJob:
    """Tiles to be made: what ``rtin.io.tileset.write_tileset`` takes.

    Attributes
    ----------
    plan : Plan
    output : Format
    settings : dict
    sources : dict of str to str
    notes : list of str
        What a user should know before the work begins.
    """

    plan: Plan
    output: Format
    settings: dict[str, Any]
    sources: dict[str, str]
    notes: list[str]

    def write(
        self,
        folder: str | os.PathLike[str],
        *,
        update: bool = False,
        executor: Executor | None = None,
        tell: Callable[[float], object] | None = None,
    ) -> Summary:
        """Make the tiles in a folder, as far as they are not there yet: see ``write_tileset``."""
        return write_tileset(
            folder,
            self.plan,
            self.output,
            settings=self.settings,
            sources=self.sources,
            update=update,
            executor=executor,
            tell=tell,
        )


def world_tiles(
    paths: Sequence[str | os.PathLike[str]],
    kind: Literal["terrain", "3dtiles"] = "terrain",
    *,
    scheme: str = "geographic",
    zoom: Zooms = (None, None),
    max_error: Sequence[float] = (),
    error_factor: float = _PIXELS,
    cells: int = _CELLS_OF_WORLD,
    fill: float | Literal["default"] | None = "default",
    geoid: Literal["egm2008", "egm96"] | None = None,
    normals: bool = True,
    about: dict[str, str] | None = None,
    band: int = 1,
    encoding: Any = None,  # noqa: ANN401
) -> TileJob:
    """Return the job of tiles for a globe, from rasters in any CRS.

    Parameters
    ----------
    paths : sequence of path
        Rasters that GDAL reads, heights in metres. Where several have a height, the first counts.
    kind : {"terrain", "3dtiles"}
        Quantized-mesh with its layer.json, or 3D Tiles 1.1.
    scheme : {"geographic", "mercator"}
        How the world is cut.
    zoom : (int or None, int or None)
        First and last. By default from 0 to the zoom whose nodes are as close as the samples of the
        finest raster, or nearest to that. Terrain always begins at 0, where CesiumJS does.
    max_error : sequence of float
        Tolerances in metres: one for the last zoom, doubled for each coarser one, or one for each
        zoom. By default ``error_factor`` times the error that CesiumJS takes a zoom to have.
    error_factor : float
        With the default of a half, terrain is off by a pixel at most where CesiumJS allows two.
    cells : int
        Along a side of a tile, a power of two.
    fill : float or None
        Height of voids in tiles that have heights; None leaves holes. By default 0 for terrain,
        through whose holes one would look into the globe, and None for 3D Tiles.
    geoid : {"egm2008", "egm96"}, optional
        What the heights are above, to turn them into heights above the ellipsoid. Where pyproj
        lacks its grid they are taken as they are, with a note.
    normals : bool
        Whether terrain gets normals for light and shade.
    about : dict of str to str, optional
        Entries of layer.json: name, description, attribution.
    band, encoding
        As in ``rtin.read_grid``.

    Raises
    ------
    OSError
        If a raster can't be read.
    TypeError, ValueError
        If a raster has no CRS, or an argument makes no sense.
    """
    from rtin.io.lattices import native_zoom

    require_word("kind", kind, ("terrain", "3dtiles"))
    require_word("scheme", scheme, SCHEMES)
    require_cells(cells)
    names = _names(paths)
    if not isinstance(normals, bool):
        raise TypeError(f"normals must be True or False, got {normals!r}")
    _require_about(about or {})
    the_scheme, raster = SCHEMES[scheme], {"band": band, "encoding": encoding}
    native = min(native_zoom(names, the_scheme, cells), _DEEPEST)
    first, last = _zooms(zoom, native, _DEEPEST)
    wanted = tolerances(first, last, max_error, _cesium(the_scheme, error_factor))
    if kind == "terrain":
        wanted |= {below: wanted[first] * 2 ** (first - below) for below in range(first)}
    lattice, notes = _lattice(names, the_scheme, last, cells, geoid, raster)
    if fill == "default":
        fill = 0.0 if kind == "terrain" else None
    wanted = dict(sorted(wanted.items()))
    largest = {zoom: _largest_cell(the_scheme, zoom, cells, wanted[zoom]) for zoom in wanted}
    plan = Plan(lattice, cells, the_scheme.roots, wanted, fill, largest, _ROUNDING[kind])
    if last > native:
        notes.append(f"zoom {native} has all that the rasters hold; finer ones add tiles only")
    plan.tiling(lattice, last)  # looks at fill before any work
    output = _format(kind, scheme, plan, normals, about or {})
    settings = {
        "format": kind,
        "scheme": scheme,
        "geoid": geoid,
        "normals": normals,
        **(about or {}),
        **raster,
    }
    return _job(plan, output, settings, names, notes)


def raster_tiles(
    path: str | os.PathLike[str],
    extension: str,
    *,
    max_error: Sequence[float],
    zoom: Zooms = (None, None),
    cells: int = _CELLS_OF_RASTER,
    local: bool = False,
    band: int = 1,
    encoding: Any = None,  # noqa: ANN401
) -> TileJob:
    """Return the job of a mesh file for each tile of a raster's own lattice.

    Parameters
    ----------
    path : path
        A raster that GDAL reads, or .npy.
    extension : str
        Of a format that ``write_mesh`` writes: ``"glb"``, ``"obj"``, ``"ply"`` or ``"stl"``.
    max_error : sequence of float
        Tolerances in units of the heights: one for the last zoom, doubled for each coarser one, or
        one for each zoom.
    zoom : (int or None, int or None)
        First and last; at zoom 0 one tile covers the raster, at the last one the nodes are all
        samples. By default the last alone.
    cells : int
        Along a side of a tile, a power of two; a smaller raster is one tile.
    local : bool
        Whether the files count x and y from the raster's middle, as engines with 32-bit places
        need; the origin is in tiles.json. By default they have those of the CRS.
    band, encoding
        As in ``rtin.read_grid``.

    Raises
    ------
    OSError
        If the raster can't be read.
    TypeError, ValueError
        If an argument makes no sense.
    """
    from rtin.io.lattices import RasterLattice
    from rtin.io.tile_meshes import PlainMeshes

    require_word("extension", extension, ("glb", "obj", "ply", "stl"))
    names, raster = _names([path]), {"band": band, "encoding": encoding}
    lattice = RasterLattice(names[0], **raster)
    size = lattice_size((lattice.rows[1], lattice.cols[1]))
    require_cells(cells)
    cells = min(cells, size)
    deepest = (size // cells).bit_length() - 1
    _require_zooms(zoom)
    first, last = _zooms((deepest if zoom[0] is None else zoom[0], zoom[1]), deepest, deepest)
    if last != deepest:
        raise ValueError(
            f"the last zoom of this raster in tiles of {cells} cells is {deepest}, where its "
            f"samples are, got {last}; to have fewer triangles, allow a larger error"
        )
    if np.size(max_error) == 0:
        raise ValueError("max_error is needed: the tolerance in units of the raster's heights")
    wanted = tolerances(first, last, max_error, lambda _: 0.0)
    plan = Plan(lattice, cells, 1, wanted, None)
    output = PlainMeshes.of_lattice(lattice, extension, last, local=local)
    placed = {
        "crs": output.placement.crs,
        "transform": list(lattice.transform[:6]),
        "origin": list(output.placement.origin),
        "scale": list(output.placement.scale),
    }
    return _job(plan, output, {"format": extension, **placed, **raster}, names, [])


def _job(
    plan: Plan, output: Format, settings: dict[str, Any], names: list[str], notes: list[str]
) -> TileJob:
    from rtin.io.lattices import fingerprint

    settings = {
        **settings,
        "tolerances": {str(zoom): value for zoom, value in plan.tolerances.items()},
        "cells": plan.cells,
        "fill": plan.fill,
    }
    return TileJob(
        plan,
        output,
        settings,
        dict(zip(map(os.path.abspath, names), fingerprint(names), strict=True)),
        notes,
    )


def _names(paths: Sequence[str | os.PathLike[str]]) -> list[str]:
    if isinstance(paths, str | os.PathLike) or not isinstance(paths, Iterable):
        raise TypeError(f"paths must be a list of rasters, got {paths!r}")
    names = [os.fspath(path) for path in paths]
    if not names:
        raise ValueError("at least one raster is wanted, got none")
    return names


def _require_about(about: Any) -> None:  # noqa: ANN401
    """Refuse what is none of the entries of layer.json that nothing depends on."""
    if not isinstance(about, dict) or not all(isinstance(text, str) for text in about.values()):
        raise TypeError(f"about must be a dict of texts, got {about!r}")
    for name in about:
        require_word("an entry of about", name, _ABOUT)


def _zooms(zoom: Zooms, native: int, deepest: int) -> tuple[int, int]:
    _require_zooms(zoom)
    last = native if zoom[1] is None else zoom[1]
    first = min(zoom[0] or 0, last) if zoom[1] is None else zoom[0] or 0
    if not 0 <= first <= last <= deepest:
        raise ValueError(f"zooms must rise within 0 to {deepest}, got {first} to {last}")
    return first, last


def _require_zooms(zoom: Zooms) -> None:
    is_pair = isinstance(zoom, tuple | list) and len(zoom) == 2
    if not is_pair or any(
        isinstance(each, bool) or not isinstance(each, int | None) for each in zoom
    ):
        raise TypeError(f"zoom must be the first and the last, whole numbers or None, got {zoom!r}")


def _cesium(scheme: Scheme, factor: float) -> Any:  # noqa: ANN401
    factor = as_zero_or_more("error_factor", factor, "as a multiple of CesiumJS's errors")
    if isinf(factor):
        raise ValueError("error_factor must be finite, got inf")
    return lambda zoom: factor * geometric_error(scheme, zoom)


def _largest_cell(scheme: Scheme, zoom: int, cells: int, tolerance: float) -> int:
    """Return how long a triangle's leg may be, in cells, for the globe to look round.

    The chord of an arc of length d on a sphere of radius r lies d² / 8 r below it. A triangle's
    longest edge, √2 legs, may lie by half of CesiumJS's error of the zoom below, or the tolerance
    where that is more.
    """
    allowed = max(tolerance, _PIXELS * geometric_error(scheme, zoom))
    leg = sqrt(4.0 * EQUATORIAL_RADIUS * allowed)
    side = 2.0 * pi * EQUATORIAL_RADIUS / (scheme.roots << zoom)
    parts = 1
    while side / parts > leg and parts < cells:
        parts *= 2
    return cells // parts


def _lattice(
    names: list[str],
    scheme: Scheme,
    zoom: int,
    cells: int,
    geoid: Literal["egm2008", "egm96"] | None,
    raster: dict[str, Any],
) -> tuple[HeightLattice, list[str]]:
    """Return the nodes of the last zoom, and what is to be said about their heights."""
    from rtin.io.lattices import MissingGeoid, WebLattice, lacks_vertical_crs

    as_given = "heights are taken as metres above the ellipsoid, as they are"
    if geoid is not None:
        try:
            return WebLattice(names, scheme, zoom, cells, geoid=geoid, **raster), []
        except MissingGeoid as error:
            notes = [f"{error}; {as_given}"]
    elif lacks_vertical_crs(names):
        notes = [f"{as_given}; --geoid egm2008 raises those above sea level by the geoid"]
    else:
        notes = []
    return WebLattice(names, scheme, zoom, cells, **raster), notes


def _format(kind: str, scheme: str, plan: Plan, normals: bool, about: dict[str, str]) -> Format:
    if kind == "terrain":
        from rtin.io.quantized_mesh import QuantizedMesh

        return QuantizedMesh(scheme, normals, about, _bounds(plan, scheme))
    from rtin.io.tiles3d import Tiles3D

    bounds = _bounds(plan, scheme) if plan.fill is None else None
    return Tiles3D(scheme, plan.cells, plan.tolerances, bounds)


def _bounds(plan: Plan, scheme: str) -> tuple[float, float, float, float]:
    """Return west, south, east and north of the lattice's heights, in degrees."""
    a, _, x, _, e, y = plan.lattice.transform[:6]
    (top, bottom), (left, right) = plan.lattice.rows, plan.lattice.cols
    west, east = x + a * left, x + a * (right - 1)
    south, north = y + e * (bottom - 1), y + e * top
    if scheme == "mercator":
        west, east = degrees(west / EQUATORIAL_RADIUS), degrees(east / EQUATORIAL_RADIUS)
        south, north = (degrees(atan(sinh(value / EQUATORIAL_RADIUS))) for value in (south, north))
    if east > 180.0:  # across the antimeridian: CesiumJS wants west below east
        west, east = -180.0, 180.0
    return west, max(south, -90.0), east, min(north, 90.0)
