"""Tiling schemes: how the world is cut into square tiles, twice as fine at every zoom."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from affine import Affine

__all__ = ["EQUATORIAL_RADIUS", "SCHEMES", "Scheme"]

EQUATORIAL_RADIUS = 6378137.0  # metres, of WGS 84
_MERCATOR_EDGE = pi * EQUATORIAL_RADIUS


@dataclass(frozen=True)
class Scheme:
    """A square, nested tiling of the world; tile rows are counted from the north.

    ``cells`` is the number of lattice cells along a side of a tile, the same at every zoom, so that
    the nodes of a zoom are every second node of the next one.

    Attributes
    ----------
    name : str
        As in ``SCHEMES`` and on the command line.
    crs : str
        Of the tiles' edges: ``"EPSG:4326"`` (x is longitude) or ``"EPSG:3857"``.
    west, north : float
        The corner where tiles and nodes are counted from, in units of the CRS.
    width : float
        Of the world, in units of the CRS; its columns close to a ring.
    roots : int
        Tiles side by side at zoom 0; there is one row of them.
    """

    name: str
    crs: str
    west: float
    north: float
    width: float
    roots: int

    def tile_shape(self, zoom: int) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return 1 << zoom, self.roots << zoom

    def spacing(self, zoom: int, cells: int) -> float:
        """Return the distance of two nodes, in units of the CRS."""
        return self.width / ((self.roots << zoom) * cells)

    def transform(self, zoom: int, cells: int) -> Affine:
        """Return what maps ``(col, row)`` of a node, counted over the whole world, to x and y."""
        spacing = self.spacing(zoom, cells)
        return Affine(spacing, 0.0, self.west, 0.0, -spacing, self.north)

    def bounds(self, zoom: int, row: int, col: int) -> tuple[float, float, float, float]:
        """Return west, south, east and north of a tile."""
        side = self.spacing(zoom, 1)
        west, north = self.west + col * side, self.north - row * side
        return west, self.north - (row + 1) * side, self.west + (col + 1) * side, north


SCHEMES = {
    scheme.name: scheme
    for scheme in (
        Scheme("geographic", "EPSG:4326", -180.0, 90.0, 360.0, 2),
        Scheme("mercator", "EPSG:3857", -_MERCATOR_EDGE, _MERCATOR_EDGE, 2 * _MERCATOR_EDGE, 1),
    )
}
