"""Real elevation models to try things on, from matplotlib's sample data: no download."""

from __future__ import annotations

import numpy as np
from affine import Affine

from rtin.grid import Grid

__all__ = ["jacksboro_fault", "topobathy"]


def jacksboro_fault() -> Grid:
    """Return the Jacksboro fault, Tennessee: 344 × 403 samples, 236 to 1076 m.

    Geographic coordinates (EPSG:4326), a sample every 1/1200 degree, from matplotlib's
    ``jacksboro_fault_dem.npz``. That file's ``ymin`` and ``ymax`` are swapped; here row 0 is north.
    """
    data = _sample_data("jacksboro_fault_dem.npz")
    north = max(float(data["ymin"]), float(data["ymax"]))
    west, dx, dy = float(data["xmin"]), float(data["dx"]), abs(float(data["dy"]))
    transform = Affine(dx, 0.0, west + dx / 2, 0.0, -dy, north - dy / 2)
    return Grid(data["elevation"], transform, "EPSG:4326")


def topobathy() -> Grid:
    """Return land and sea floor around a coast: heights in metres, negative below the sea.

    From matplotlib's ``topobathy.npz`` (row 0 is south there, north here), in degrees.
    """
    data = _sample_data("topobathy.npz")
    longitude, latitude = data["longitude"], data["latitude"]
    dx = (longitude[-1] - longitude[0]) / (len(longitude) - 1)
    dy = (latitude[-1] - latitude[0]) / (len(latitude) - 1)
    transform = Affine(dx, 0.0, longitude[0], 0.0, -dy, latitude[-1])
    return Grid(np.asarray(data["topo"])[::-1], transform, "EPSG:4326")


def _sample_data(name: str) -> dict[str, np.ndarray]:
    from matplotlib.cbook import get_sample_data

    with np.load(get_sample_data(name, asfileobj=False)) as file:
        return dict(file)
