"""3D Tiles 1.1 (OGC 22-025r4): a GLB for each tile, and the tileset that says which there are.

Tiles lie at ``{z}/{x}/{y}.glb``, x from the west and y from the north. The tileset is explicit: a
tile's own smallest and largest height bound it, and the tiles of Mercator, which a quadtree of
regions has no room for, are bounded as truly as those of degrees. So that no file grows with the
terrain, four zooms share one: deeper ones go on in ``{z}/{x}/{y}.json``, an external tileset that
lies beside its root's GLB.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import atan, ceil, log2, pi, radians, sinh, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtin.io._gltf import bounds, packed, y_up
from rtin.pyramid import geometric_error
from rtin.schemes import EQUATORIAL_RADIUS, SCHEMES, Scheme
from rtin.tiles import Place, Tile

if TYPE_CHECKING:
    from rtin.io.tileset import TileRecord

__all__ = ["Tiles3D", "content", "position_step", "tileset_files"]

_FLOAT32_STEPS = 2**24  # whole numbers up to this have a float32
_MOST_SHORT = 65535  # vertices whose indices take two bytes; the last index has a meaning
_ZOOMS_IN_FILE = 4
_MOST_BITS = 31  # of rows and columns of tiles
_WORLD = (-180.0, -90.0, 180.0, 90.0)
_ZOOMS_APART = 2  # of tiles side by side whose cracks a skirt hides

_Tree = dict[str, Any]
_Bounds = tuple[float, float, float, float]


@dataclass(frozen=True)
class Tiles3D:
    """The ``rtin.io.tileset.Format`` of 3D Tiles.

    Attributes
    ----------
    scheme : str
        Name of a tiling scheme: ``"geographic"`` or ``"mercator"``.
    cells : int
        Along a side of a tile.
    tolerances : dict of int to float
        Of each zoom, in metres: the geometric error of its tiles.
    bounds : (float, float, float, float), optional
        West, south, east and north of all heights, in degrees: viewers fly to what has terrain,
        not to all of the largest tile. None where tiles are filled beyond the heights.
    """

    scheme: str
    cells: int
    tolerances: dict[int, float]
    bounds: _Bounds | None = None

    def name(self, zoom: int, row: int, col: int) -> str:
        """Return a tile's path: zoom, column, and row from the north."""
        return f"{_stem(zoom, row, col)}.glb"

    def encode(self, zoom: int, tile: Tile, largest_range: float) -> bytes:
        """Return a tile's GLB."""
        step = self._step(zoom, largest_range)
        return content(tile, SCHEMES[self.scheme], zoom, skirt=self.skirt(zoom), step=step)

    def rounding(self, zoom: int, largest_range: float) -> float:
        """Return how far a vertex may be moved: half a step along each axis."""
        return sqrt(3.0) / 2.0 * self._step(zoom, largest_range)

    def roots(self, zoom: int) -> frozenset[Place]:  # noqa: ARG002
        """Return none: there may be holes."""
        return frozenset()

    def skirt(self, zoom: int) -> float:
        """Return how far skirts hang down: as two surfaces two zooms apart may differ."""
        coarser = max(zoom - _ZOOMS_APART, min(self.tolerances))
        return sum(self.tolerances[each] + self._bulge(each) for each in (zoom, coarser))

    def _bulge(self, zoom: int) -> float:
        """Return how far the globe may lie above a chord across a tile, or the longest allowed."""
        scheme = SCHEMES[self.scheme]
        allowed = max(self.tolerances[zoom], geometric_error(scheme, zoom))
        return min(_side(scheme, zoom) ** 2 / (4.0 * EQUATORIAL_RADIUS), allowed)

    def index(
        self, records: Callable[[], Iterator[TileRecord]], tolerances: dict[int, float]
    ) -> Iterator[tuple[str, bytes]]:
        """Yield tileset.json and the external tilesets."""
        above = self._moved(records())
        below = {zoom: self.skirt(zoom) + moved for zoom, moved in above.items()}
        tiles = (
            (at.zoom, at.row, at.col, at.low - below[at.zoom], at.high + above[at.zoom])
            for at in records()
        )
        return tileset_files(tiles, tolerances, SCHEMES[self.scheme], self.bounds)

    def _moved(self, records: Iterable[TileRecord]) -> dict[int, float]:
        """Return how far positions may have been moved at each zoom."""
        ranges: dict[int, float] = {}
        for tile in records:
            ranges[tile.zoom] = max(ranges.get(tile.zoom, 0.0), tile.high - tile.low)
        # Nodes may lie above and below the highest and the lowest vertex, by the tolerance.
        return {
            zoom: self.rounding(zoom, span + 2.0 * self.tolerances[zoom])
            for zoom, span in ranges.items()
        }

    def _step(self, zoom: int, largest_range: float) -> float:
        return position_step(SCHEMES[self.scheme], zoom, largest_range + self.skirt(zoom))


def position_step(scheme: Scheme, zoom: int, largest_range: float) -> float:
    """Return the step of Earth-centred coordinates at a zoom, in metres: a power of two.

    ``largest_range`` is the largest difference of heights within a tile, with its skirt. Counted
    from the middle of a tile, every vertex has exact float32 coordinates in this step.
    """
    reach = _side(scheme, zoom) + largest_range
    return float(2.0 ** ceil(log2(reach / _FLOAT32_STEPS)))


def _side(scheme: Scheme, zoom: int) -> float:
    """Return the side of a tile at the equator in metres."""
    return 2.0 * pi * EQUATORIAL_RADIUS / (scheme.roots << zoom)


def _stem(zoom: int, row: int, col: int) -> str:
    return f"{zoom}/{col}/{row}"


# --- one tile -----------------------------------------------------------------------------------


def content(
    tile: Tile, scheme: Scheme, zoom: int, *, skirt: float, step: float | None = None
) -> bytes:
    """Return a tile as a GLB, Earth-centred (EPSG:4978), for 3D Tiles without a transform.

    The node's translation and the float32 positions are multiples of ``step``, and their sum is
    exact: a vertex that two tiles share is at one and the same place in both, at most half a step
    along each axis from where it should be. It has the same normal in both, that of the slopes in
    ``tile``. The vertices of skirts lie below those of the four borders, with the same normals, so
    that the light on a skirt is that on the terrain above it. Texture coordinates are 0 to 1 over
    the tile, v from the north.

    Parameters
    ----------
    tile : Tile
        Of the scheme's nodes; heights in metres above the ellipsoid.
    scheme : Scheme
    zoom : int
    skirt : float
        How far triangles hang down along the borders, to hide cracks between zooms; 0 for none.
    step : float, optional
        A power of two, one for all tiles of a zoom: ``position_step`` of the largest range among
        them. By default that of this tile's own range.

    Raises
    ------
    ValueError
        If the step is too small for float32 to hold multiples of it throughout the tile.
    """
    triangles, tops = _with_skirts(tile, skirt)
    n_own = len(tile.heights)
    nodes = np.concatenate([np.arange(n_own), tops])
    heights = tile.heights[nodes]
    heights[n_own:] -= skirt
    if step is None:
        step = position_step(scheme, zoom, float(np.ptp(heights)))
    places, normals = _vertices(tile, nodes, heights, scheme, zoom, step)
    low, high = bounds(places)
    centre = np.rint((low + high) / 2.0)
    offsets = places - centre
    if (high - low).max() / 2.0 > _FLOAT32_STEPS - 1:
        raise ValueError(
            f"a tile of {step * (high - low).max():g} m has no float32 positions in steps of "
            f"{step:g} m; take a larger step"
        )
    uv = np.column_stack([tile.cols[nodes], tile.rows[nodes]]) / tile.cells
    attributes = {
        "POSITION": y_up(step * offsets).astype("<f4"),
        "NORMAL": y_up(normals).astype("<f4"),
        "TEXCOORD_0": uv.astype("<f4"),
    }

    def finish(tree: _Tree) -> None:
        tree["nodes"][0]["translation"] = y_up(step * centre).tolist()
        del tree["materials"][0]["doubleSided"]

    return packed(
        triangles.astype("<u2" if len(nodes) <= _MOST_SHORT else "<u4"), attributes, finish
    )


def _with_skirts(tile: Tile, skirt: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return triangles, and which vertex each one that they use beyond the tile's lies below.

    ::

        b --- a      a tile's edge, seen from inside: its triangle is on the left of a to b
        |   / |
        | /   |
        d --- c      below it
    """
    from rtin._kernels.tiles3d import border_edges

    if skirt == 0.0:
        return tile.triangles, np.empty(0, np.int32)
    edges = np.empty((4 * tile.cells, 2), np.int32)
    edges = edges[: border_edges(tile.triangles, tile.rows, tile.cols, tile.cells, edges)]
    tops, below = np.unique(edges, return_inverse=True)
    a, b = edges.T
    c, d = (len(tile.heights) + below.reshape(edges.shape)).astype(np.int32).T
    hanging = np.stack([a, c, d, a, d, b], axis=1).reshape(-1, 3)
    return np.concatenate([tile.triangles, hanging]), tops


def _vertices(
    tile: Tile,
    nodes: NDArray[np.integer[Any]],
    heights: NDArray[np.float64],
    scheme: Scheme,
    zoom: int,
    step: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Earth-centred places in whole steps, and normals."""
    from rtin._kernels.tiles3d import fill_vertices

    rows = tile.row * tile.cells + tile.rows[nodes].astype(np.int64)
    cols = tile.col * tile.cells + tile.cols[nodes].astype(np.int64)
    cols %= (scheme.roots << zoom) * tile.cells
    world = (scheme.spacing(zoom, tile.cells), scheme.west, scheme.north, scheme.crs == "EPSG:3857")
    places, normals = np.empty((2, len(nodes), 3))
    fill_vertices(rows, cols, heights, tile.slopes[nodes], *world, step, places, normals)
    return places, normals


# --- the tileset --------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Level:
    """The tiles of one zoom in the order of a Z-shaped curve: a tile's children are neighbours."""

    codes: NDArray[np.int64]
    lows: NDArray[np.float64]  # of the tile and all below it
    highs: NDArray[np.float64]
    is_drawn: NDArray[np.bool_]  # has a GLB
    first_child: NDArray[np.intp]  # in the next level; one more than there are tiles

    def place(self, number: int) -> Place:
        """Return row and column of a tile."""
        code = int(self.codes[number])
        return _every_second_bit(code >> 1), _every_second_bit(code)


def tileset_files(
    tiles: Iterable[tuple[int, int, int, float, float]],
    tolerances: dict[int, float],
    scheme: Scheme,
    bounds: _Bounds | None = None,
) -> Iterator[tuple[str, bytes]]:
    """Yield path and content of tileset.json and of the external tilesets that it leads to.

    Any set of tiles will do: ancestors that have no GLB are there as mere boxes. A tile is bounded
    by its region and by the heights of all tiles below it. Its geometric error is the tolerance of
    its zoom; a box has that of the zoom before, or the side of a tile in metres where no tile lies
    above, so that viewers go on to its children as soon as they are some pixels wide. Memory: some
    60 bytes for each tile.

    Parameters
    ----------
    tiles : iterable of (int, int, int, float, float)
        Zoom, row from the north, column, lowest and highest height of each tile that has a GLB, in
        metres above the ellipsoid; in any order, each once.
    tolerances : dict of int to float
        Of each zoom, not growing with it.
    scheme : Scheme
    bounds : (float, float, float, float), optional
        West, south, east and north in degrees, beyond which no tile has anything.

    Raises
    ------
    ValueError
        If there is no tile.
    """
    levels = _levels(tiles)
    if not levels:
        raise ValueError(
            "a tileset needs at least one tile, got none: no node of these zooms has a height; "
            "take finer zooms, or rasters with heights"
        )
    return _Writer(levels, tolerances, scheme, np.radians(bounds or _WORLD).tolist()).files()


@dataclass(frozen=True)
class _Writer:
    levels: dict[int, _Level]
    tolerances: dict[int, float]
    scheme: Scheme
    bounds: list[float]  # in radians

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Yield tileset.json, then the external tilesets from coarse to fine."""
        first_drawn = min(zoom for zoom, level in self.levels.items() if level.is_drawn.any())
        alone = [zoom for zoom, level in self.levels.items() if len(level.codes) == 1]
        top = min(max(alone, default=0), first_drawn)
        root = self._root(top)
        yield "tileset.json", _document(root, max(self._side(top), root["geometricError"]))
        for zoom in filter(self._begins_file, range(top + 1, max(self.levels))):
            for number in np.flatnonzero(np.diff(self.levels[zoom].first_child)).tolist():
                root = self._tile(zoom, number, zoom, "../../")
                yield f"{self._stem(zoom, number)}.json", _document(root, root["geometricError"])

    def _root(self, zoom: int) -> _Tree:
        """Return the only tile of a zoom, or a box around the two of zoom 0."""
        tiles = [self._tile(zoom, i, zoom, "") for i in range(len(self.levels[zoom].codes))]
        if len(tiles) == 1:
            return tiles[0]
        regions = np.array([tile["boundingVolume"]["region"] for tile in tiles])
        low, high = regions.min(axis=0), regions.max(axis=0)
        return {
            "boundingVolume": {"region": [*low[:2], *high[2:4], low[4], high[5]]},
            "geometricError": max(self._side(zoom), *(tile["geometricError"] for tile in tiles)),
            "children": tiles,
        }

    def _tile(self, zoom: int, number: int, first_zoom: int, up: str) -> _Tree:
        """Return a tile with all below it in the file whose root is at ``first_zoom``."""
        level = self.levels[zoom]
        first, end = level.first_child[number : number + 2].tolist()
        is_drawn = bool(level.is_drawn[number])
        tile: _Tree = {
            "boundingVolume": {"region": self._region(zoom, number)},
            "geometricError": self._error(zoom, is_drawn=is_drawn),
        }
        if first < end and zoom > first_zoom and self._begins_file(zoom):
            tile["content"] = {"uri": f"{up}{self._stem(zoom, number)}.json"}
            return tile
        if is_drawn:
            tile["content"] = {"uri": f"{up}{self._stem(zoom, number)}.glb"}
        if first < end:
            children = range(first, end)
            tile["children"] = [self._tile(zoom + 1, child, first_zoom, up) for child in children]
        return tile

    def _begins_file(self, zoom: int) -> bool:
        """Return whether tiles of a zoom are roots of files, counted from the finest zoom.

        So the many files there, which have its tiles besides, are full.
        """
        return (max(self.levels) - zoom) % _ZOOMS_IN_FILE == 0

    def _error(self, zoom: int, *, is_drawn: bool) -> float:
        return self.tolerances.get(zoom if is_drawn else zoom - 1, self._side(zoom))

    def _side(self, zoom: int) -> float:
        """Return the side of a tile in metres, or the first tolerance where that is more."""
        return max(_side(self.scheme, zoom), self.tolerances[min(self.tolerances)])

    def _region(self, zoom: int, number: int) -> list[float]:
        level = self.levels[zoom]
        west, south, east, north = self.scheme.bounds(zoom, *level.place(number))
        if self.scheme.crs == "EPSG:3857":
            west, east = west / EQUATORIAL_RADIUS, east / EQUATORIAL_RADIUS
            south, north = (
                atan(sinh(south / EQUATORIAL_RADIUS)),
                atan(sinh(north / EQUATORIAL_RADIUS)),
            )
        else:
            west, south, east, north = map(radians, (west, south, east, north))
        heights = float(level.lows[number]), float(level.highs[number])
        low, high = np.array(self.bounds[:2]), np.array(self.bounds[2:])
        corners = np.array([[west, south], [east, north]]).clip(low, high)
        return [*corners.ravel().tolist(), *heights]

    def _stem(self, zoom: int, number: int) -> str:
        return _stem(zoom, *self.levels[zoom].place(number))


def _document(root: _Tree, error: float) -> bytes:
    """Return a tileset, which viewers leave out as soon as ``error`` looks small enough."""
    tileset = {
        "asset": {"version": "1.1", "generator": "rtin"},
        "geometricError": error,
        "root": {**root, "refine": "REPLACE"},
    }
    return json.dumps(tileset, separators=(",", ":")).encode("ascii")


def _levels(tiles: Iterable[tuple[int, int, int, float, float]]) -> dict[int, _Level]:
    """Return the tiles zoom by zoom, with all their ancestors."""
    fields = [("zoom", "i8"), ("row", "i8"), ("col", "i8"), ("low", "f8"), ("high", "f8")]
    table = np.fromiter(tiles, np.dtype(fields))
    levels: dict[int, _Level] = {}
    below = None
    for zoom in range(int(table["zoom"].max(initial=-1)), -1, -1):
        levels[zoom] = below = _level(table[table["zoom"] == zoom], below)
    return dict(sorted(levels.items()))


def _level(own: NDArray[Any], below: _Level | None) -> _Level:
    """Return the tiles of a zoom and the parents of those below."""
    codes, lows, highs = _interleaved(own["row"], own["col"]), own["low"], own["high"]
    is_drawn, parents = np.ones(len(own), bool), np.empty(0, np.int64)
    if below is not None:
        parents = below.codes >> 2
        codes = np.concatenate([codes, parents])
        lows, highs = np.concatenate([lows, below.lows]), np.concatenate([highs, below.highs])
        is_drawn = np.concatenate([is_drawn, np.zeros(len(parents), bool)])
    order = np.argsort(codes, kind="stable")
    codes, firsts = np.unique(codes[order], return_index=True)
    return _Level(
        codes,
        np.minimum.reduceat(lows[order], firsts),
        np.maximum.reduceat(highs[order], firsts),
        np.logical_or.reduceat(is_drawn[order], firsts),
        np.append(np.searchsorted(parents, codes), len(parents)),
    )


def _interleaved(rows: NDArray[np.int64], cols: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers that have the bits of rows and columns in turn.

    Those of a tile's children are four times its own and up to three more.
    """
    codes = np.zeros(len(rows), np.int64)
    for bit in range(_MOST_BITS):
        codes |= (cols >> bit & 1) << 2 * bit | (rows >> bit & 1) << 2 * bit + 1
    return codes


def _every_second_bit(code: int) -> int:
    return sum((code >> 2 * bit & 1) << bit for bit in range(_MOST_BITS))
