"""Small meshes made without the library, for tests of files and pictures."""

import numpy as np

from rtin.mesh import TriangleMesh


def bumpy(rows=7, cols=9, *, cells=None, crs=None, west=0.0, north=0.0, step=30.0, heights=None):
    """Two triangles in each cell (of those in the boolean mask ``cells``) of a bumpy surface."""
    row, col = np.mgrid[:rows, :cols]
    if heights is None:
        heights = 300.0 + 40.0 * np.sin(1.1 * row) * np.cos(0.7 * col) + col
    x, y = west + step * col, north - step * row
    vertices = np.column_stack([x.ravel(), y.ravel(), np.float32(heights).ravel()])
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    if cells is not None:
        corner = corner[np.asarray(cells).ravel()]
    upper = np.column_stack([corner + cols, corner + 1, corner])
    lower = np.column_stack([corner + 1, corner + cols, corner + cols + 1])
    triangles = np.stack([upper, lower], axis=1).reshape(-1, 3)
    return TriangleMesh(np.float64(vertices), triangles, crs)


def with_hole():
    cells = np.ones((6, 8), dtype=bool)
    cells[2:4, 3:6] = False
    return bumpy(cells=cells)


def touching_at_a_point():
    """Two squares that share one corner only, north-west and south-east of it."""
    cells = np.zeros((6, 8), dtype=bool)
    cells[:3, :4] = cells[3:, 4:] = True
    return bumpy(cells=cells)


def in_utm():
    return bumpy(crs="EPSG:32616", west=500_000.125, north=4_600_000.375)


def in_degrees():
    return bumpy(crs="EPSG:4326", west=-84.4, north=36.7, step=1 / 1200)
