"""Quantized-mesh terrain, as CesiumJS reads it (specification 1.0), and its ``layer.json``.

A vertex has 15 bits each for its place in the tile and for its height. All tiles of a zoom count
heights in the same step, from a multiple of that step: a vertex that two tiles share is decoded to
one and the same height, and what is lost is at most half a step.
"""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rtin.schemes import EQUATORIAL_RADIUS, SCHEMES, Scheme
from rtin.tiles import Place, Tile

if TYPE_CHECKING:
    from rtin.io.tileset import TileRecord

__all__ = ["QuantizedMesh", "encode", "gzipped", "height_step"]

_LARGEST = 32767
_MOST_SHORT = 1 << 16  # vertices whose indices take two bytes
_OCT_NORMALS = 1
_LEAST_EXPONENT = -10  # of 2, so that float32 holds heights on Earth in such steps
_GZIP_LEVEL = 4  # 6: 4 % smaller files, and 2.6 times as long


@dataclass(frozen=True)
class QuantizedMesh:
    """The ``rtin.io.tileset.Format`` of quantized-mesh tiles for CesiumJS.

    Attributes
    ----------
    scheme : str
        Name of a tiling scheme: ``"geographic"`` or ``"mercator"``.
    normals : bool
        Whether vertices have normals.
    about : dict
        Further entries of layer.json: name, description, attribution, version.
    bounds : (float, float, float, float)
        West, south, east and north of the rasters in degrees.
    """

    scheme: str
    normals: bool
    about: dict[str, str]
    bounds: tuple[float, float, float, float]

    def name(self, zoom: int, row: int, col: int) -> str:
        """Return a tile's path: zoom, column, and row from the south (TMS)."""
        return f"{zoom}/{col}/{(1 << zoom) - 1 - row}.terrain"

    def encode(self, zoom: int, tile: Tile, largest_range: float) -> bytes:
        """Return a tile's file, compressed by gzip."""
        step = height_step(largest_range)
        return gzipped(encode(tile, SCHEMES[self.scheme], zoom, step, normals=self.normals))

    def rounding(self, zoom: int, largest_range: float) -> float:  # noqa: ARG002
        """Return half the step in which heights are counted."""
        return height_step(largest_range) / 2.0

    def roots(self, zoom: int) -> frozenset[Place]:
        """Return all tiles of zoom 0: CesiumJS asks for them wherever the terrain is."""
        n_roots = SCHEMES[self.scheme].roots if zoom == 0 else 0
        return frozenset((0, col) for col in range(n_roots))

    def index(
        self, records: Callable[[], Iterator[TileRecord]], tolerances: dict[int, float]
    ) -> Iterator[tuple[str, bytes]]:
        """Yield layer.json."""
        available: list[list[dict[str, int]]] = [[] for _ in range(max(tolerances) + 1)]
        places: dict[int, list[Place]] = {}
        for record in records():
            places.setdefault(record.zoom, []).append((record.row, record.col))
        for zoom, those in places.items():
            available[zoom] = [_in_tms(zoom, rectangle) for rectangle in rectangles(those)]
        layer = {
            "tilejson": "2.1.0",
            "format": "quantized-mesh-1.0",
            "scheme": "tms",
            "projection": SCHEMES[self.scheme].crs,
            "tiles": ["{z}/{x}/{y}.terrain?v={version}"],
            "version": "1.0.0",
            **self.about,
            "minzoom": 0,
            "maxzoom": max(tolerances),
            "bounds": list(self.bounds),
            "extensions": ["octvertexnormals"] if self.normals else [],
            "available": available,
        }
        yield "layer.json", json.dumps(layer, indent=1).encode()


def height_step(largest_range: float) -> float:
    """Return the step of heights that lets tiles hold a range: a power of two, a millimetre or so.

    Heights then decode exactly. CesiumJS takes 32767 steps for the height of a tile, so that a step
    larger than needed would have it draw tiles that nobody sees.
    """
    exponent = _LEAST_EXPONENT
    while 2.0**exponent * (_LARGEST - 2) < largest_range:
        exponent += 1
    return float(2.0**exponent)


def encode(
    tile: Tile, scheme: Scheme, zoom: int, height_step: float, *, normals: bool = True
) -> bytes:
    """Return a tile as quantized-mesh 1.0, not compressed.

    Parameters
    ----------
    tile : Tile
        Of the scheme's nodes; heights in metres above the ellipsoid.
    scheme : Scheme
    zoom : int
    height_step : float
        Heights are rounded to multiples of it; a power of two.
    normals : bool
        Whether to add the normals of the slopes in ``tile``, oct-encoded.

    Raises
    ------
    ValueError
        If heights differ by more than 32767 steps, or float32 can't hold their least multiple.
    """
    from rtin._kernels import quantized_mesh as kernels

    order = np.empty(len(tile.heights), np.int64)
    indices = np.empty(tile.triangles.size, np.uint32)
    order = order[: kernels.number_by_use(tile.triangles, len(order), order, indices)]
    shares = _shares_from_south(tile, scheme, zoom)
    u, v, steps, lowest = _numbers(tile, order, shares, height_step)
    heights = height_step * (lowest + steps)
    positions = np.empty((len(order), 3))
    world = (scheme.west, scheme.north, scheme.crs == "EPSG:3857")
    side = scheme.spacing(zoom, 1)
    kernels.fill_positions(u, v, heights, tile.row, tile.col, side, *world, positions)
    centre, radius = kernels.bounding_sphere(positions)
    occlusion = kernels.horizon_occlusion_point(positions, centre)
    minimum, maximum = height_step * lowest, height_step * (lowest + _LARGEST)
    parts = [
        struct.pack("<3d2f4d3d", *centre, minimum, maximum, *centre, radius, *occlusion),
        struct.pack("<I", len(order)),
        *(_differences(values) for values in (u, v, steps)),
        *_indexed(tile, order, indices),
    ]
    if normals:
        nodes = tile.row * tile.cells + tile.rows[order], tile.col * tile.cells + tile.cols[order]
        octs = np.empty((len(order), 2), np.uint8)
        spacing, period = scheme.spacing(zoom, tile.cells), (scheme.roots << zoom) * tile.cells
        kernels.fill_normals(*nodes, tile.slopes[order], period, spacing, *world, octs)
        parts += [struct.pack("<BI", _OCT_NORMALS, octs.size), octs.tobytes()]
    return b"".join(parts)


def gzipped(data: bytes) -> bytes:
    """Return the same bytes for the same data, compressed."""
    return gzip.compress(data, _GZIP_LEVEL, mtime=0)


def rectangles(places: Iterable[Place]) -> list[tuple[int, int, int, int]]:
    """Return first row, first column, last row and last column of rectangles that cover places.

    Each place lies in exactly one of them, and nothing else does.
    """
    open_runs: dict[tuple[int, int], int] = {}  # first and last column to first row
    done = []
    row_before = -1
    for row, runs in _runs_by_row(places):
        for run, first_row in list(open_runs.items()):
            if run not in runs or row_before != row - 1:
                done.append((first_row, run[0], row_before, run[1]))
                del open_runs[run]
        for run in runs:
            open_runs.setdefault(run, row)
        row_before = row
    done += [(first, run[0], row_before, run[1]) for run, first in open_runs.items()]
    return sorted(done)


def _runs_by_row(places: Iterable[Place]) -> Iterator[tuple[int, list[tuple[int, int]]]]:
    """Yield each row with the first and last columns of its runs."""
    rows: dict[int, list[int]] = {}
    for row, col in sorted(places):
        rows.setdefault(row, []).append(col)
    for row, cols in rows.items():
        breaks = np.flatnonzero(np.diff(cols) > 1)
        firsts, lasts = np.append(0, breaks + 1), np.append(breaks, len(cols) - 1)
        yield row, [(cols[a], cols[b]) for a, b in zip(firsts, lasts, strict=True)]


def _in_tms(zoom: int, rectangle: tuple[int, int, int, int]) -> dict[str, int]:
    first_row, first_col, last_row, last_col = rectangle
    top = (1 << zoom) - 1
    return {
        "startX": first_col,
        "startY": top - last_row,
        "endX": last_col,
        "endY": top - first_row,
    }


def _shares_from_south(tile: Tile, scheme: Scheme, zoom: int) -> NDArray[np.float64]:
    """Return where each row of nodes lies between the southern edge, 0, and the northern, 1.

    By latitude, in Mercator too: the specification and CesiumJS take v so.
    """
    rows = np.arange(tile.cells + 1)
    if scheme.crs != "EPSG:3857":
        return (tile.cells - rows) / tile.cells
    y = scheme.north - scheme.spacing(zoom, tile.cells) * (tile.row * tile.cells + rows)
    latitudes = np.arctan(np.sinh(y / EQUATORIAL_RADIUS))
    shares: NDArray[np.float64] = (latitudes - latitudes[-1]) / (latitudes[0] - latitudes[-1])
    return shares


def _numbers(
    tile: Tile, order: NDArray[np.int64], shares: NDArray[np.float64], step: float
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], int]:
    """Return u, v and the steps above the lowest one of each vertex, and the lowest one."""
    u = np.rint(tile.cols[order] * (_LARGEST / tile.cells)).astype(np.int32)
    v = np.rint(_LARGEST * shares[tile.rows[order]]).astype(np.int32)
    multiples = np.rint(tile.heights[order] / step)
    lowest, highest = int(multiples.min()), int(multiples.max())
    if highest - lowest > _LARGEST:
        raise ValueError(
            f"heights of the tile in row {tile.row}, column {tile.col} differ by "
            f"{step * (highest - lowest):g} m, more than {_LARGEST} steps of {step:g} m; "
            "take a larger step"
        )
    if float(np.float32(step * lowest)) != step * lowest:
        raise ValueError(
            f"heights about {step * lowest:g} m have no exact float32 in steps of {step:g} m; "
            "take a larger step"
        )
    return u, v, (multiples - lowest).astype(np.int32), lowest


def _differences(values: NDArray[np.int32]) -> bytes:
    from rtin._kernels.quantized_mesh import zigzag_of_differences

    codes = np.empty(len(values), np.uint16)
    zigzag_of_differences(values, codes)
    return codes.astype("<u2", copy=False).tobytes()


def _indexed(tile: Tile, order: NDArray[np.int64], indices: NDArray[np.uint32]) -> Iterator[bytes]:
    """Yield the triangles and the vertices on the four borders, each with its length."""
    kind = "<u2" if len(order) <= _MOST_SHORT else "<u4"
    if kind == "<u4" and len(order) % 2 == 1:
        yield b"\0\0"  # what came before are six bytes a vertex
    yield struct.pack("<I", len(tile.triangles))
    yield indices.astype(kind).tobytes()
    rows, cols = tile.rows[order], tile.cols[order]
    for on_border, along in (
        (cols == 0, -rows),  # western, from the south
        (rows == tile.cells, -cols),  # southern, from the east
        (cols == tile.cells, rows),  # eastern, from the north
        (rows == 0, cols),  # northern, from the west
    ):
        border = np.flatnonzero(on_border)
        yield struct.pack("<I", len(border))
        yield border[np.argsort(along[border])].astype(kind).tobytes()
