"""Coordinate reference systems, in the one form that the package keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pyproj

__all__ = ["as_crs", "metres_per_unit", "radians_per_unit"]


def as_crs(value: Any) -> pyproj.CRS | None:  # noqa: ANN401
    """Return ``value`` as a pyproj CRS; None stays None. Raises ValueError for an unknown one."""
    if value is None:
        return None
    import pyproj

    try:
        return pyproj.CRS.from_user_input(value)
    except pyproj.exceptions.CRSError as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"crs must be one that pyproj knows, got {value!r}: {reason}") from None


def metres_per_unit(crs: pyproj.CRS, latitude: float) -> tuple[float, float]:
    """Return the metres in one unit of longitude and in one of latitude at ``latitude``.

    The unit, usually the degree, and ``latitude`` are those of the geographic CRS. From the radii
    of curvature of its ellipsoid, which may be that of another planet.
    """
    geod = crs.get_geod()
    assert geod is not None, "a geographic CRS has an ellipsoid"
    radians = radians_per_unit(crs)
    # Not exactly a pole, where a unit of longitude has no length and could not be undone.
    phi = np.clip(latitude * radians, -1.5707, 1.5707)
    flattened = 1.0 - geod.es * np.sin(phi) ** 2
    prime_vertical = geod.a / np.sqrt(flattened)
    meridian = geod.a * (1.0 - geod.es) / flattened**1.5
    return float(prime_vertical * np.cos(phi) * radians), float(meridian * radians)


def radians_per_unit(crs: pyproj.CRS) -> float:
    """Return the angle of one unit of longitude or latitude of a geographic CRS."""
    geodetic = crs.geodetic_crs
    assert geodetic is not None, "a geographic CRS has a geodetic one, be it itself"
    return float(geodetic.axis_info[0].unit_conversion_factor)
