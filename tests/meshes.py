"""Meshes to refine, drawn by hypothesis: right-triangulated ones, and TINs of every kind.

Each is a right mesh, but may have vertices that belong to no triangle. Heights are multiples of
1/16.
"""

import numpy as np
from affine import Affine
from hypothesis import assume
from hypothesis import strategies as st
from scipy.spatial import Delaunay

import rtin
import terrains
from rtin import validity
from rtin.mesh import TriangleMesh

SCHEMES = ["4T-LE", "4T-SS", "bisection"]

OBLONG = {
    "wide cells": Affine.scale(5.0, -1.0),
    "tall cells": Affine.scale(1.0, -5.0),
    "wide cells, rotated": Affine.rotation(20.0) @ Affine.scale(3.0, -1.0),
}
TRANSFORMS = terrains.TRANSFORMS | OBLONG
# Places that refining keeps exact.
EXACT = ["north up", "south up", "oblong cells", "transposed", "wide cells", "tall cells"]

schemes = st.sampled_from(SCHEMES)
seeds = st.integers(0, 2**32 - 1)


def targets_of(mesh, rng):
    """Numbers of some triangles: one, a few, half of them, or all."""
    chosen = np.flatnonzero(rng.random(mesh.n_triangles) < rng.choice([0.0, 0.1, 0.5, 1.1]))
    return chosen if len(chosen) else rng.integers(0, mesh.n_triangles, 1)


def renumbered(mesh, rng):
    """The same mesh with its vertices and triangles in another order."""
    places = rng.permutation(mesh.n_vertices)
    numbers = np.argsort(places)
    triangles = rng.permutation(numbers[mesh.triangles])
    return TriangleMesh(mesh.vertices[places], triangles, mesh.crs)


def uniform(n_cells, transform=TRANSFORMS["north up"]):
    """All the triangles of a lattice of 2**k cells along each side."""
    noise = terrains.noise((n_cells + 1, n_cells + 1))
    return rtin.coarsen(rtin.Grid(noise, transform), max_error=0.0)


def delaunay(points, rng):
    heights = rng.integers(-800, 800, len(points)) / 16.0
    triangles = Delaunay(points).simplices
    return TriangleMesh.from_triangles(np.column_stack([points, heights]), triangles)


def strip(n_triangles, rng):
    """Triangles in a row, ever longer: all edges but those between neighbours are the boundary."""
    along = np.cumsum(rng.random(n_triangles + 2) + 0.2) ** rng.choice([1.0, 2.0])
    points = np.column_stack([along, np.arange(n_triangles + 2) % 2 * rng.uniform(0.5, 3.0)])
    first = np.arange(n_triangles)
    heights = rng.integers(-800, 800, len(points)) / 16.0
    return TriangleMesh.from_triangles(
        np.column_stack([points, heights]), np.column_stack([first, first + 1, first + 2])
    )


def equilateral(n_rows, turn=0.0):
    """A lattice of equilateral triangles: all edges tie."""
    row, col = np.divmod(np.arange(n_rows * n_rows), n_rows)
    x, y = col + 0.5 * row, np.sqrt(0.75) * row
    points = np.c_[np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, x]
    cells = np.flatnonzero((row < n_rows - 1) & (col < n_rows - 1))
    lower = np.c_[cells, cells + 1, cells + n_rows]
    upper = np.c_[cells + 1, cells + n_rows + 1, cells + n_rows]
    return TriangleMesh.from_triangles(points, np.r_[lower, upper])


def joined(one, other):
    """Two meshes as one, side by side."""
    gap = one.bounds[1, 0] - other.bounds[0, 0] + 1.0
    return TriangleMesh(
        np.vstack([one.vertices, other.vertices + np.array([gap, 0.0, 0.0])]),
        np.vstack([one.triangles, other.triangles + one.n_vertices]),
    )


def without(mesh, gone):
    """A mesh with holes; vertices stay, so that some may belong to no triangle."""
    return TriangleMesh(mesh.vertices, mesh.triangles[~gone], mesh.crs)


@st.composite
def right_triangulated(draw, transforms=tuple(TRANSFORMS)):
    """Coarsened rasters on cells of every shape."""
    transform = TRANSFORMS[draw(st.sampled_from(list(transforms)))]
    if draw(st.booleans()):
        return uniform(draw(st.sampled_from([1, 2, 4])), transform)
    heights = draw(terrains.rasters(largest=9))
    return rtin.coarsen(rtin.Grid(heights, transform), max_error=draw(terrains.tolerances))


@st.composite
def tins(draw, generic=False):
    """Delaunay meshes and others; in ``generic`` ones no two edges of a triangle tie."""
    rng = np.random.default_rng(draw(seeds))
    kinds = ["cloud", "one triangle", "two triangles", "strip"]
    ties = ["whole numbers", "two clouds", "equilateral"]
    kind = draw(st.sampled_from(kinds if generic else kinds + ties))
    if kind == "whole numbers":
        mesh = delaunay(np.unique(rng.integers(0, 7, (25, 2)), axis=0).astype(float), rng)
    elif kind == "two clouds":
        mesh = joined(delaunay(rng.random((8, 2)), rng), delaunay(100 * rng.random((9, 2)), rng))
    elif kind == "equilateral":
        mesh = equilateral(int(rng.integers(2, 5)), rng.choice([0.0, 0.3, 2.2]))
    elif kind == "strip":
        mesh = strip(int(rng.integers(3, 20)), rng)
    else:
        n_points = {"cloud": int(rng.integers(5, 30)), "one triangle": 3, "two triangles": 4}[kind]
        mesh = delaunay(rng.random((n_points, 2)) * 10.0 ** rng.integers(-3, 5), rng)
    if mesh.n_triangles > 3 and draw(st.booleans()):
        mesh = without(mesh, rng.random(mesh.n_triangles) < 0.2)
    assume(mesh.n_triangles and is_right(mesh))
    return renumbered(mesh, rng) if draw(st.booleans()) else mesh


def is_right(mesh):
    """Whether nothing is wrong, but perhaps vertices that belong to no triangle."""
    return all("belongs to no triangle" in complaint for complaint in validity.complaints(mesh))


any_mesh = right_triangulated() | tins()
