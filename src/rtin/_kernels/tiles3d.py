"""Arithmetic of 3D Tiles: Earth-centred vertices, and the edges that skirts hang from."""

from rtin._kernels._jit import jit
from rtin._kernels.ellipsoid import earth_centred, node_normal, node_place


@jit
def fill_vertices(
    rows, cols, heights, slopes, spacing, west, north, is_mercator, step, places, normals
):
    """Write where nodes of a scheme are, in whole steps and Earth-centred, and their normals.

    A node is given the same bits in every tile: all is computed from its numbers in the world.
    """
    for i in range(len(rows)):
        longitude, latitude = node_place(rows[i], cols[i], spacing, west, north, is_mercator)
        x, y, z = earth_centred(longitude, latitude, heights[i])
        places[i, 0], places[i, 1], places[i, 2] = round(x / step), round(y / step), round(z / step)
        x, y, z = node_normal(
            rows[i], cols[i], spacing, west, north, is_mercator, slopes[i, 0], slopes[i, 1]
        )
        normals[i, 0], normals[i, 1], normals[i, 2] = x, y, z


@jit
def border_edges(triangles, rows, cols, cells, edges):
    """Write the edges of triangles that lie on a tile's four sides; return how many.

    Each edge runs with its triangle on the left, the tile outside on the right.
    """
    n_edges = 0
    for triangle in range(len(triangles)):
        for corner in range(3):
            a, b = triangles[triangle, corner], triangles[triangle, (corner + 1) % 3]
            on_row = rows[a] == rows[b] and (rows[a] == 0 or rows[a] == cells)
            on_col = cols[a] == cols[b] and (cols[a] == 0 or cols[a] == cells)
            if on_row or on_col:
                edges[n_edges, 0], edges[n_edges, 1] = a, b
                n_edges += 1
    return n_edges
