"""Places of points on a raster."""

import numpy as np

from rtin._kernels._jit import jit


@jit
def snapped(place, margin):
    """A row or column, or the whole one that it is closer to than the margin."""
    nearest = np.rint(place)
    return nearest if abs(place - nearest) < margin else place


@jit
def fill_places(points, transform, margin, first, end, places):
    """Write row and column of some points.

    They are measured from the raster's own origin, so that large coordinates don't cost digits.
    """
    a, b, x0, d, e, y0 = transform
    determinant = a * e - b * d
    for i in range(first, end):
        x, y = points[i, 0] - x0, points[i, 1] - y0
        places[i, 0] = snapped((a * y - d * x) / determinant, margin)
        places[i, 1] = snapped((e * x - b * y) / determinant, margin)
