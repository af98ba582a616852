"""The WGS 84 ellipsoid: Earth-centred coordinates, directions, lengths. Angles are in radians."""

import math

from rtin._kernels._jit import jit

SEMI_MAJOR = 6378137.0
_FLATTENING = 1.0 / 298.257223563
SEMI_MINOR = SEMI_MAJOR * (1.0 - _FLATTENING)
_ECCENTRICITY_SQUARED = _FLATTENING * (2.0 - _FLATTENING)


@jit
def earth_centred(longitude, latitude, height):
    """Return x, y and z of a place, its height above the ellipsoid."""
    sine, cosine = math.sin(latitude), math.cos(latitude)
    normal = SEMI_MAJOR / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * sine * sine)
    across = (normal + height) * cosine
    z = (normal * (1.0 - _ECCENTRICITY_SQUARED) + height) * sine
    return across * math.cos(longitude), across * math.sin(longitude), z


@jit
def metres_per_radian(latitude):
    """Return the lengths of a radian to the east and of one to the north."""
    sine = math.sin(latitude)
    share = 1.0 - _ECCENTRICITY_SQUARED * sine * sine
    normal = SEMI_MAJOR / math.sqrt(share)
    return normal * math.cos(latitude), normal * (1.0 - _ECCENTRICITY_SQUARED) / share


@jit
def surface_normal(longitude, latitude, east_slope, north_slope):
    """Return the unit normal, Earth-centred, of a surface that rises by these metres per metre."""
    sin_lon, cos_lon = math.sin(longitude), math.cos(longitude)
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    length = math.sqrt(1.0 + east_slope * east_slope + north_slope * north_slope)
    x = cos_lat * cos_lon + east_slope * sin_lon + north_slope * sin_lat * cos_lon
    y = cos_lat * sin_lon - east_slope * cos_lon + north_slope * sin_lat * sin_lon
    z = sin_lat - north_slope * cos_lat
    return x / length, y / length, z / length


@jit
def node_place(row, col, spacing, west, north, is_mercator):
    """Return longitude and latitude of a node of a tiling scheme, which may have fractions."""
    x, y = west + spacing * col, north - spacing * row
    if is_mercator:
        return x / SEMI_MAJOR, math.atan(math.sinh(y / SEMI_MAJOR))
    return math.radians(x), math.radians(y)


@jit
def node_normal(row, col, spacing, west, north, is_mercator, east_rise, north_rise):
    """Return the normal at a node, given the rise of the terrain from one node to the next."""
    longitude, latitude = node_place(row, col, spacing, west, north, is_mercator)
    east_length, north_length = metres_per_radian(latitude)
    radians = spacing / SEMI_MAJOR if is_mercator else math.radians(spacing)
    # A step to the north of Mercator's y is cos(latitude) times one of longitude.
    north_radians = radians * math.cos(latitude) if is_mercator else radians
    # At a pole a step to the east has no length, and the terrain no slope that way.
    east_step = radians * east_length
    east_slope = east_rise / east_step if east_step > 1e-6 * SEMI_MAJOR * radians else 0.0
    return surface_normal(
        longitude, latitude, east_slope, north_rise / (north_radians * north_length)
    )
