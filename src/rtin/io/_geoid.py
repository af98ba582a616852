"""The geoid's height above the ellipsoid, from the grids that PROJ has."""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtin._crs import as_crs

if TYPE_CHECKING:
    import pyproj

__all__ = ["GEOIDS", "require_geoid", "undulation", "vertical"]

GEOIDS = {"egm2008": "EPSG:3855", "egm96": "EPSG:5773"}
Floats = NDArray[np.float64]


def vertical(crs: pyproj.CRS) -> pyproj.CRS | None:
    """Return the part of a compound CRS that says how high, None where there is none."""
    if not crs.is_compound:
        return None
    return next((part for part in crs.sub_crs_list if part.is_vertical), None)


def undulation(heights: str, longitudes: Floats, latitudes: Floats) -> tuple[Floats]:
    """Return the metres of a vertical CRS's zero above the ellipsoid; NaN where unknown."""
    _, _, z = _transformer(heights).transform(longitudes, latitudes, np.zeros(longitudes.shape))
    found = np.asarray(z)
    return (np.where(np.isfinite(found), found, np.nan),)


class MissingGeoid(ValueError):  # noqa: N818  (named as ValueError is)
    """PROJ lacks the grid of a geoid."""


def require_geoid(heights: str) -> None:
    """Raise ValueError, naming the missing grid, unless PROJ knows a vertical CRS's zero."""
    _transformer(heights)


@lru_cache(maxsize=16)
def _transformer(heights: str) -> Any:  # noqa: ANN401
    import pyproj
    from pyproj.transformer import TransformerGroup

    surface = as_crs(heights)
    assert surface is not None
    above_geoid = pyproj.crs.CompoundCRS("heights", [as_crs("EPSG:4326"), surface])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        group = TransformerGroup(above_geoid, "EPSG:4979", always_xy=True, allow_ballpark=False)
    if group.transformers:
        return group.transformers[0]
    grids = [grid.short_name for way in group.unavailable_operations for grid in way.grids]
    if not grids:
        raise ValueError(f"PROJ knows no way from {surface.name} to heights above the ellipsoid")
    raise MissingGeoid(
        f"{surface.name} needs the grid {grids[0]}, which PROJ does not have; get it by "
        f"`pyproj sync --file {grids[0]}` and try again"
    )
