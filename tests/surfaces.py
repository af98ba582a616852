"""Surfaces to measure from and to, each awkward in its own way."""

import numpy as np
from affine import Affine

import rtin
import terrains
from rtin.mesh import TriangleMesh


def cloud(points):
    """Points as triangles without a size."""
    return TriangleMesh(points, np.repeat(np.arange(len(points))[:, np.newaxis], 3, axis=1))


def full(grid):
    """All the finest triangles of a grid, as a mesh."""
    return rtin.coarsen(grid, removable=np.zeros(grid.shape, bool))


def grid(shape, holes="none", transform="north up", terrain="waves", dtype=np.float32):
    heights = terrains.pierced(terrains.GALLERY[terrain](shape), terrains.HOLES[holes](shape))
    return rtin.Grid(heights.astype(dtype), TRANSFORMS[transform])


SHEARED = Affine(2.0, 1.5, -3.0, 0.25, -1.0, 7.0)
TRANSFORMS = terrains.TRANSFORMS | {
    "sheared": SHEARED,
    "mirrored and sheared, far away": Affine.translation(5e5, 4e6) @ SHEARED @ Affine.scale(-9, 4),
}


def scattered_heights(shape=(5, 6)):
    """Heights of all magnitudes: their differences need more digits than float32 has."""
    return 10.0 ** np.random.default_rng(4).uniform(-3.0, 3.0, shape)


def tiny_beside_huge():
    """Hundreds of tiny triangles in the corner of one that is a thousand times as wide."""
    small = full(rtin.Grid(terrains.noise((9, 9)) / 800, Affine.scale(1 / 8, -1 / 8)))
    huge = [[1.5, 1.0, 0.0], [1000.0, 3.0, 40.0], [2.0, 1200.0, -25.0]]
    return TriangleMesh(
        np.vstack([huge, small.vertices]), np.vstack([[[0, 1, 2]], small.triangles + 3])
    )


def outlier():
    """All triangles in one cell of the search, but for one far away."""
    small = full(rtin.Grid(terrains.noise((6, 6)) / 80))
    far = np.array([[8e5, 7e5, 3.0], [8e5 + 1, 7e5, 1.0], [8e5, 7e5 + 2, 2.0]])
    return TriangleMesh(
        np.vstack([far, small.vertices]), np.vstack([[[0, 1, 2]], small.triangles + 3])
    )


def soup(n=60, seed=0, size=3.0, width=20.0):
    """Triangles anywhere and any way up, that overhang and pierce each other."""
    rng = np.random.default_rng(seed)
    middles = width * rng.random((n, 1, 3)) * [1.0, 0.6, 0.3]
    corners = middles + size * rng.standard_normal((n, 3, 3))
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def slivers(n=40, seed=1):
    """Triangles ever slimmer, down to the last digit, with the sharp corner at any of the three."""
    rng = np.random.default_rng(seed)
    corners = 10.0 * rng.random((n, 3, 3))
    share = rng.uniform(0.0, 1.0, (n, 1)) * rng.integers(0, 2, (n, 1))
    third = corners[:, 0] + share * (corners[:, 1] - corners[:, 0])
    corners[:, 2] = third + rng.standard_normal((n, 3)) * 10.0 ** np.linspace(-1, -16, n)[:, None]
    for own in corners:
        rng.shuffle(own)
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def degenerate():
    """Two equal corners, three equal ones, three in a row, and one triangle with an area."""
    at = [[0, 0, 0], [4, 0, 1], [0, 3, 2], [0, 0, 0], [8, 0, 2], [12, 0, 3], [-2, -2, 5], [7, 7, 7]]
    triangles = [[0, 1, 2], [0, 3, 1], [1, 4, 5], [4, 1, 5], [6, 6, 6], [7, 2, 7], [2, 2, 6]]
    return TriangleMesh(np.array(at, float), triangles)


def upright():
    """Walls: triangles that have no area seen from above, of a house without a roof."""
    at = [[x, y, z] for z in (0.0, 5.0) for x, y in ((0, 0), (6, 1), (5, 7), (-1, 6))]
    sides = [(i, (i + 1) % 4) for i in range(4)]
    triangles = [t for i, j in sides for t in ((i, j, j + 4), (i, j + 4, i + 4))]
    return TriangleMesh(at, triangles)


MESHES = {
    "coarsened": lambda: rtin.coarsen(grid((17, 23), "pond"), max_error=6.0),
    "coarsened, far away": lambda: rtin.coarsen(grid((17, 23), "none", "rotated"), max_error=6.0),
    "tiny beside huge": tiny_beside_huge,
    "outlier": outlier,
    "soup": soup,
    "slivers": slivers,
    "degenerate": degenerate,
    "upright": upright,
    "one triangle": lambda: soup(1),
    "one upright triangle": lambda: TriangleMesh([[0, 0, 0], [3, 1, 0], [3, 1, 9]], [[0, 1, 2]]),
    "a point": lambda: cloud(np.array([[3.0, 4.0, 5.0]])),
}

GRIDS = {
    "one cell": lambda: grid((2, 2)),
    "two rows": lambda: grid((2, 40), "scattered"),
    "two columns": lambda: grid((40, 2), "none", "transposed"),
    "pond": lambda: grid((17, 23), "pond"),
    "scattered": lambda: grid((13, 11), "scattered", "south up"),
    "swath, oblong cells": lambda: grid((16, 13), "swath", "oblong cells"),
    "rotated": lambda: grid((11, 14), "one sample", "rotated"),
    "rotated, south up": lambda: grid((11, 14), "corner", "rotated, south up"),
    "sheared": lambda: grid((12, 9), "scattered", "sheared"),
    "far away": lambda: grid((9, 12), "pond", "mirrored and sheared, far away"),
    "float64": lambda: rtin.Grid(terrains.noise((8, 9)) + 1 / 3),
    "all magnitudes": lambda: rtin.Grid(np.float32(scattered_heights())),
}


def points_around(surface, n, rng):
    """Points on the surface, close by, and far away on all sides."""
    mesh = full(surface) if isinstance(surface, rtin.Grid) else surface
    corners = mesh.vertices[mesh.triangles[rng.integers(0, mesh.n_triangles, n)]]
    inside = np.einsum("ni,nix->nx", rng.dirichlet([1.0, 1.0, 1.0], n), corners)
    used = mesh.vertices[mesh.triangles.ravel()]
    extent = np.ptp(used, axis=0).max() + 1.0
    reach = extent * 10.0 ** rng.uniform(-4.0, 1.0, (n, 1)) * (rng.random((n, 1)) < 0.9)
    return inside + reach * rng.standard_normal((n, 3))
