"""Where a mesh lies in a file: the shift and scale between the world and the file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtin._crs import as_crs, metres_per_unit, radians_per_unit
from rtin.io import solid
from rtin.mesh import TriangleMesh

if TYPE_CHECKING:
    import pyproj

__all__ = ["PlacedMesh", "Placement", "place", "placement"]

_Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Placement:
    """A shift and a scale: file = (world - origin) * scale.

    Parameters
    ----------
    origin : three floats
        The point of the world, in units of the CRS and of the heights, that is at zero in the file.
    scale : three floats
        File units per unit of the world, for x, y and z; none is zero.
    crs : str or None
        The world's coordinate reference system: ``"EPSG:4326"`` or the like where an authority
        lists it, otherwise WKT2, or PROJJSON where WKT2 would not give it back.
    note : str
        What was done, in one line for people; empty if x and y are as in the mesh.
    """

    origin: _Triple = (0.0, 0.0, 0.0)
    scale: _Triple = (1.0, 1.0, 1.0)
    crs: str | None = None
    note: str = ""

    def to_file(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the world's ``vertices``, shape (n, 3), as they stand in the file."""
        return (vertices - self.origin) * self.scale

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the file's ``points``, shape (n, 3), as they stand in the world."""
        return points / self.scale + self.origin

    @classmethod
    def from_dict(cls, stored: dict[str, Any]) -> Placement:
        """Return the placement that ``PlacedMesh.as_dict`` stored.

        Raises
        ------
        ValueError
            If it does not hold three finite numbers for the origin and three for the scale, none
            of them zero.
        """
        try:
            origin = np.asarray(stored["origin"], dtype=np.float64)
            scale = np.asarray(stored["scale"], dtype=np.float64)
            crs = stored.get("crs")
            if origin.shape != (3,) or scale.shape != (3,) or not isinstance(crs, str | None):
                raise TypeError
        except (KeyError, TypeError, ValueError, AttributeError):
            raise ValueError(f"an origin, a scale and a CRS are wanted, got {stored!r}") from None
        if not np.isfinite([origin, scale]).all() or not scale.all():
            raise ValueError(f"origin and scale must be finite and no scale zero, got {stored!r}")
        return cls(_triple(origin), _triple(scale), crs)


@dataclass(frozen=True, eq=False)
class PlacedMesh:
    """A mesh as it stands in a file, and what the writers need besides.

    Parameters
    ----------
    vertices : float64, shape (n, 3)
        In file coordinates.
    triangles : int32, shape (m, 3)
    placement : Placement
        How the vertices came from the world.
    terrain_bounds : float64, shape (2, 3)
        Smallest and largest x, y and z of the terrain, without a solid's bottom, in the file.
    is_solid : bool
        Whether walls and a bottom are there.
    tags : int32, shape (m,), or None
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    placement: Placement
    terrain_bounds: NDArray[np.float64]
    is_solid: bool
    tags: NDArray[np.int32] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return what a file has to store so that a reader can undo the placement.

        The counts tell a reader whether another program has changed the mesh since.
        """
        return {
            "crs": self.placement.crs,
            "origin": list(self.placement.origin),
            "scale": list(self.placement.scale),
            "vertices": len(self.vertices),
            "triangles": len(self.triangles),
        }

    def as_json(self) -> str:
        """Return ``as_dict`` as one line of ASCII."""
        return json.dumps(self.as_dict())

    @property
    def centre(self) -> NDArray[np.float64]:
        """The middle of the terrain in x and y, in file coordinates; its z is zero."""
        x, y, _ = self.terrain_bounds.mean(axis=0)
        return np.array([x, y, 0.0])

    def area_vectors(self) -> NDArray[np.float64]:
        """Return each triangle's normal, as long as twice its area, shape (m, 3)."""
        corners = self.vertices[self.triangles]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def place(mesh: TriangleMesh, placed: Placement, base: float | None) -> PlacedMesh:
    """Return ``mesh`` as ``placed`` says, closed to a solid of thickness ``base`` if that is given.

    ``base`` is in file units: heights that are exaggerated do not thicken the bottom.
    """
    terrain = TriangleMesh(placed.to_file(mesh.vertices), mesh.triangles, tags=mesh.tags)
    shape = terrain if base is None else solid.close(terrain, base)
    is_solid = base is not None
    return PlacedMesh(shape.vertices, shape.triangles, placed, terrain.bounds, is_solid, shape.tags)


def placement(
    mesh: TriangleMesh,
    *,
    z_scale: float = 1.0,
    keep_degrees: bool = False,
    centred: bool = False,
) -> Placement:
    """Return where ``write_mesh`` puts ``mesh``.

    Parameters
    ----------
    mesh : TriangleMesh
    z_scale : float
        What heights are multiplied by.
    keep_degrees : bool
        Leave the x and y of a geographic CRS in degrees, instead of metres around the centre.
    centred : bool
        Put the middle of the mesh at x = y = 0, as formats with 32-bit numbers need.

    Returns
    -------
    Placement
        Its ``note`` is the line to show to people. Heights are only ever multiplied by ``z_scale``,
        never shifted, so that a raster's float32 heights stay as they are in 32-bit formats too.
    """
    crs_text = None if mesh.crs is None else _text_of(mesh.crs)
    if mesh.crs is not None and mesh.crs.is_geographic and not keep_degrees:
        return _in_metres(mesh, mesh.crs, crs_text, z_scale)
    scale = (1.0, 1.0, float(z_scale))
    if not centred:
        return Placement(scale=scale, crs=crs_text)
    x, y = _round_centre(mesh)
    note = f"x and y are measured from {x:.12g}, {y:.12g}"
    return Placement((x, y, 0.0), scale, crs_text, note)


def _in_metres(
    mesh: TriangleMesh, crs: pyproj.CRS, crs_text: str | None, z_scale: float
) -> Placement:
    longitude, latitude = _round_centre(mesh)
    metres_east, metres_north = metres_per_unit(crs, latitude)
    degrees = float(np.degrees(radians_per_unit(crs)))
    where = f"x = {longitude:.12g}, y = {latitude:.12g} of the CRS"
    if not crs.is_derived:  # as one with a rotated pole is, whose x and y are no longitude of maps
        east = (longitude * degrees + 180.0) % 360.0 - 180.0
        where = f"{_compass(latitude * degrees, 'NS')} {_compass(east, 'EW')}"
    return Placement(
        (longitude, latitude, 0.0),
        (metres_east, metres_north, float(z_scale)),
        crs_text,
        f"x and y scaled from degrees to metres around {where}",
    )


def _round_centre(mesh: TriangleMesh) -> tuple[float, float]:
    """Return the middle of x and y, rounded to a thousandth of the extent for people to read."""
    low, high = mesh.bounds[:, :2]
    extent = float((high - low).max())
    digits = 3 - int(np.floor(np.log10(extent))) if extent > 0.0 else 3
    x, y = ((low + high) / 2.0).tolist()
    return round(x, digits), round(y, digits)


def _compass(degrees: float, letters: str) -> str:
    return f"{abs(degrees):.4g} {letters[degrees < 0]}"


def _triple(values: NDArray[np.float64]) -> _Triple:
    x, y, z = values.tolist()
    return x, y, z


def _text_of(crs: pyproj.CRS) -> str:
    """Return the short name of ``crs`` if that means exactly this CRS; if not, WKT2 or PROJJSON.

    A derived CRS, such as one with a rotated pole, may come out of its WKT as another one.
    """
    authority = crs.to_authority(min_confidence=100)
    names = [] if authority is None else [":".join(authority)]
    wkt = crs.to_wkt()
    for text in (*names, wkt):
        if as_crs(text) == crs:
            return text
    json_text = crs.to_json()
    return json_text if as_crs(json_text) == crs else wkt
