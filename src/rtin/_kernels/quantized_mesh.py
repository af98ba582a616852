"""Arithmetic of quantized-mesh tiles: numbers of vertices, bounds, normals."""

import math

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.ellipsoid import (
    SEMI_MAJOR,
    SEMI_MINOR,
    earth_centred,
    node_normal,
    node_place,
)

LARGEST = 32767  # u, v and heights are 0 to this


@jit
def number_by_use(triangles, n_vertices, order, indices):
    """Number the vertices by their first use; write them and the indices less the next number.

    Returns how many are used.
    """
    numbers = np.full(n_vertices, -1, np.int64)
    n_used = 0
    for triangle in range(len(triangles)):
        for corner in range(3):
            vertex = triangles[triangle, corner]
            code = n_used - numbers[vertex]
            if numbers[vertex] < 0:
                numbers[vertex] = n_used
                order[n_used] = vertex
                n_used += 1
                code = 0
            indices[3 * triangle + corner] = code
    return n_used


@jit
def zigzag_of_differences(values, codes):
    """Write each value less the one before, with the sign in the lowest bit."""
    before = 0
    for i in range(len(values)):
        difference = values[i] - before
        codes[i] = (difference << 1) ^ (difference >> 31)
        before = values[i]


@jit
def oct_byte(value):
    """A number from -1 to 1 as a byte."""
    return np.uint8(math.floor((min(max(value, -1.0), 1.0) * 0.5 + 0.5) * 255.0 + 0.5))


@jit
def oct_encoded(x, y, z):
    """A unit vector as two bytes: its place on an octahedron, unfolded (Cigolle et al., 2014)."""
    size = abs(x) + abs(y) + abs(z)
    p, q = x / size, y / size
    if z < 0.0:
        p, q = (
            (1.0 - abs(q)) * (1.0 if p >= 0.0 else -1.0),
            (1.0 - abs(p)) * (1.0 if q >= 0.0 else -1.0),
        )
    return oct_byte(p), oct_byte(q)


@jit
def fill_normals(rows, cols, slopes, period, spacing, west, north, is_mercator, normals):
    """Write the normals at nodes of the world: the same bytes for a node in every tile."""
    for i in range(len(rows)):
        x, y, z = node_normal(
            rows[i], cols[i] % period, spacing, west, north, is_mercator, slopes[i, 0], slopes[i, 1]
        )
        normals[i, 0], normals[i, 1] = oct_encoded(x, y, z)


@jit
def fill_positions(u, v, heights, tile_row, tile_col, side, west, north, is_mercator, positions):
    """Write the Earth-centred places of vertices as a reader decodes them."""
    place = side, west, north, is_mercator
    left, top = node_place(tile_row, tile_col, *place)
    right, bottom = node_place(tile_row + 1, tile_col + 1, *place)
    for i in range(len(u)):
        longitude = left + (right - left) * (u[i] / LARGEST)
        latitude = bottom + (top - bottom) * (v[i] / LARGEST)
        positions[i] = earth_centred(longitude, latitude, heights[i])


@jit
def bounding_sphere(positions):
    """Centre of the box around points, and the distance of the farthest of them."""
    low, high = positions[0].copy(), positions[0].copy()
    for i in range(len(positions)):
        for axis in range(3):
            low[axis] = min(low[axis], positions[i, axis])
            high[axis] = max(high[axis], positions[i, axis])
    centre = (low + high) / 2.0
    radius_squared = 0.0
    for i in range(len(positions)):
        squared = 0.0
        for axis in range(3):
            squared += (positions[i, axis] - centre[axis]) ** 2
        radius_squared = max(radius_squared, squared)
    return centre, math.sqrt(radius_squared) * (1.0 + 1e-12)


@jit
def horizon_occlusion_point(positions, centre):
    """Point towards ``centre`` that the ellipsoid hides only where it hides all positions.

    Scaled so that the ellipsoid is the unit sphere (Ring, "Horizon culling", 2013). NaN where there
    is none, as for half a globe; comparisons with it then say that nothing is hidden.
    """
    x, y, z = centre[0] / SEMI_MAJOR, centre[1] / SEMI_MAJOR, centre[2] / SEMI_MINOR
    length = math.sqrt(x * x + y * y + z * z)
    distance = 0.0
    for i in range(len(positions)):
        px, py = positions[i, 0] / SEMI_MAJOR, positions[i, 1] / SEMI_MAJOR
        pz = positions[i, 2] / SEMI_MINOR
        size = math.sqrt(px * px + py * py + pz * pz)
        cos_alpha = (px * x + py * y + pz * z) / (size * length) if length > 1e-9 else -1.0
        sin_alpha = math.sqrt(max(0.0, 1.0 - cos_alpha * cos_alpha))
        raised = max(size, 1.0)
        cos_beta = 1.0 / raised
        sin_beta = math.sqrt(raised * raised - 1.0) * cos_beta
        cosine = cos_alpha * cos_beta - sin_alpha * sin_beta
        if cosine <= 1e-9:
            return np.full(3, np.nan)
        distance = max(distance, 1.0 / cosine)
    return np.array([x, y, z]) * (distance * (1.0 + 1e-12) / length)
