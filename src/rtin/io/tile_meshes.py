"""A mesh file for each tile of a raster's own lattice, fitting together as they are loaded."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import ceil, log2
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin.io import meshes
from rtin.io._gltf import packed, y_up
from rtin.io._placement import PlacedMesh, Placement, place, placement
from rtin.mesh import TriangleMesh
from rtin.tiles import HeightLattice, Place, Tile

if TYPE_CHECKING:
    from rtin.io.tileset import TileRecord

__all__ = ["PlainMeshes", "mesh_of"]

_FLOAT32_STEPS = 2**24  # whole numbers up to this have a float32
_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlainMeshes:
    """The ``rtin.io.tileset.Format`` of mesh files: ``{z}/{x}/{y}.glb`` or another extension.

    x counts tiles from the west, y from the north. All files are placed alike: where
    ``write_mesh`` would scale a geographic raster to metres, it does so around the middle of the
    raster, here for every tile. A vertex that two tiles share is at the same place in both files,
    number for number:

    - .ply and .obj hold it as it is in 64 bits, .stl in 32, counted from the raster's middle;
    - .glb has float32 positions around a node at the middle of the tile. Both are multiples of a
      power of two, common to the zoom, in x and y, at most 2.4e-7 times the side of a tile: so
      their sum is exact, and x and y are moved by at most half of that step. Heights become
      float32, as they are in most rasters.

    The normals of .glb are those of the raster's slopes, and equal on both sides of a border.
    ``read_mesh`` gives back the tile in the raster's CRS.

    Attributes
    ----------
    transform : affine.Affine
        Maps (col, row) of a node of the last zoom to (x, y).
    crs : pyproj.CRS or None
    extension : str
        ``"glb"``, ``"obj"``, ``"ply"`` or ``"stl"``.
    last : int
        The zoom at which nodes are the raster's samples.
    placement : Placement
        Of all tiles in their files.
    """

    transform: Affine
    crs: Any
    extension: str
    last: int
    placement: Placement

    @classmethod
    def of_lattice(
        cls, lattice: HeightLattice, extension: str, last: int, *, local: bool = False
    ) -> PlainMeshes:
        """Return the format for the tiles of a raster; local ones count from its middle."""
        corners = _corners(lattice.transform, lattice.rows, lattice.cols)
        outline = TriangleMesh(corners, np.array([[0, 1, 2]], np.int32), lattice.crs)
        placed = placement(outline, centred=local or extension == "stl")
        return cls(lattice.transform, lattice.crs, extension, last, placed)

    def name(self, zoom: int, row: int, col: int) -> str:
        """Return a tile's path: zoom, column, and row from the north."""
        return f"{zoom}/{col}/{row}.{self.extension}"

    def encode(self, zoom: int, tile: Tile, largest_range: float) -> bytes:  # noqa: ARG002
        """Return the tile's file."""
        transform = self._transform(zoom)
        placed = place(mesh_of(tile, transform, self.crs), self.placement, None)
        suffix = f".{self.extension}"
        meshes.require_range(placed.vertices, suffix)
        if self.extension == "glb":
            return _glb(tile, placed, self._in_file(transform))
        return meshes.ENCODERS[suffix](placed)

    def rounding(self, zoom: int, largest_range: float) -> float:  # noqa: ARG002
        """Return 0: what float32 does to heights that have no float32 is not counted."""
        return 0.0

    def roots(self, zoom: int) -> frozenset[Place]:  # noqa: ARG002
        """Return none: there may be holes."""
        return frozenset()

    def index(
        self, records: Callable[[], Iterator[TileRecord]], tolerances: dict[int, float]
    ) -> Iterator[tuple[str, bytes]]:
        """Yield tiles.json: how the files are placed, and a line for each of them."""
        head = {
            "crs": self.placement.crs,
            "origin": self.placement.origin,
            "scale": self.placement.scale,
            "tolerances": {str(zoom): value for zoom, value in tolerances.items()},
        }
        lines = ",\n".join(json.dumps(self._entry(record)) for record in records())
        yield "tiles.json", f'{json.dumps(head)[:-1]}, "tiles": [\n{lines}\n]}}\n'.encode()

    def _entry(self, record: TileRecord) -> dict[str, Any]:
        return {
            "file": self.name(record.zoom, record.row, record.col),
            "zoom": record.zoom,
            "row": record.row,
            "col": record.col,
            "low": record.low,
            "high": record.high,
            "vertices": record.n_vertices,
            "triangles": record.n_triangles,
            "error": record.error,
        }

    def _transform(self, zoom: int) -> Affine:
        step = 2.0 ** (self.last - zoom)
        a, b, c, d, e, f = self.transform[:6]
        return Affine(step * a, step * b, c, step * d, step * e, f)

    def _in_file(self, transform: Affine) -> Affine:
        """Return what maps nodes to x and y in the file, but for a shift."""
        x_scale, y_scale, _ = self.placement.scale
        a, b, _, d, e, _ = transform[:6]
        return Affine(x_scale * a, x_scale * b, 0.0, y_scale * d, y_scale * e, 0.0)


def mesh_of(tile: Tile, transform: Affine, crs: Any = None) -> TriangleMesh:  # noqa: ANN401
    """Return a tile's mesh in the world.

    A node has the same x and y, bit for bit, in every tile.

    Parameters
    ----------
    tile : Tile
    transform : affine.Affine
        Maps (col, row) of a node of the whole lattice to (x, y).
    crs : pyproj.CRS or str, optional
    """
    rows = tile.row * tile.cells + tile.rows.astype(np.int64)
    cols = tile.col * tile.cells + tile.cols.astype(np.int64)
    vertices = np.column_stack([*_world(transform, rows, cols), tile.heights])
    triangles = tile.triangles
    if transform.determinant > 0.0:  # rows run north
        triangles = np.ascontiguousarray(triangles[:, [1, 0, 2]])
    return TriangleMesh(vertices, triangles, crs)


def _glb(tile: Tile, placed: PlacedMesh, transform: Affine) -> bytes:
    """Return a tile's GLB; ``transform`` maps steps between nodes to those in the file."""
    step = _position_step(tile.cells, transform)
    steps = np.rint(placed.vertices[:, :2] / step)
    centre = np.rint((steps.min(axis=0) + steps.max(axis=0)) / 2.0)
    offsets = np.column_stack([step * (steps - centre), placed.vertices[:, 2]])
    uv = np.column_stack([tile.cols, tile.rows]) / tile.cells
    attributes = {
        "POSITION": y_up(offsets).astype("<f4"),
        "NORMAL": y_up(_normals(tile.slopes, transform)).astype("<f4"),
        "TEXCOORD_0": uv.astype("<f4"),
    }

    def finish(tree: dict[str, Any]) -> None:
        tree["nodes"][0]["translation"] = y_up(np.append(step * centre, 0.0)).tolist()
        tree["meshes"][0]["extras"] = {"rtin": placed.as_dict()}

    return packed(placed.triangles.astype("<u4"), attributes, finish)


def _position_step(cells: int, transform: Affine) -> float:
    """Return the power of two of which x and y are multiples in a tile's file."""
    a, b, _, d, e, _ = transform[:6]
    reach = cells * max(abs(a) + abs(b), abs(d) + abs(e))
    return float(2.0 ** ceil(log2(reach / _FLOAT32_STEPS)))


def _normals(slopes: _Floats, transform: Affine) -> _Floats:
    """Return unit normals given the rise of the heights per column and per row to the north."""
    a, b, _, d, e, _ = transform[:6]
    per_col, per_row = slopes[:, 0], -slopes[:, 1]
    x_slope = (e * per_col - d * per_row) / transform.determinant
    y_slope = (a * per_row - b * per_col) / transform.determinant
    length = np.sqrt(x_slope * x_slope + y_slope * y_slope + 1.0)
    return np.column_stack([-x_slope / length, -y_slope / length, 1.0 / length])


def _corners(transform: Affine, rows: tuple[int, int], cols: tuple[int, int]) -> _Floats:
    (top, bottom), (left, right) = (rows[0], rows[1] - 1), (cols[0], cols[1] - 1)
    corner_rows = np.array([top, top, bottom, bottom])
    corner_cols = np.array([left, right, right, left])
    return np.column_stack([*_world(transform, corner_rows, corner_cols), np.zeros(4)])


def _world(
    transform: Affine, rows: NDArray[np.integer[Any]], cols: NDArray[np.integer[Any]]
) -> tuple[_Floats, _Floats]:
    a, b, c, d, e, f = transform[:6]
    return a * cols + b * rows + c, d * cols + e * rows + f
