"""Terrain on a lattice of its own choosing, seen from above."""

from __future__ import annotations

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin.criteria import surface_at_samples
from rtin.grid import Grid, Metres
from rtin.mesh import TriangleMesh

__all__ = ["heights_on", "lattice_over", "sampled"]

_Surface = Grid | TriangleMesh
_SLIMMEST = 4.0  # times the side of a square lattice: what is longer gets fewer samples


def lattice_over(surface: _Surface, n_samples: int) -> tuple[Affine, tuple[int, int], Affine]:
    """Return where samples over the bounds of a terrain lie, their rows and columns, and metres.

    They are north up, and about as far apart in x as in y on the ground; the last transform
    is the first one in metres.
    """
    (west, south, _), (east, north, _) = surface.bounds.tolist()
    metres = Metres(0.0, 0.0, 1.0, 1.0)
    if surface.crs is not None and surface.crs.is_geographic:
        metres = Metres.around(surface.crs, (west + east) / 2, (south + north) / 2)
    width, height = (east - west) * metres.east, (north - south) * metres.north
    spacing = max(
        np.sqrt(width * height / n_samples), max(width, height) / (_SLIMMEST * np.sqrt(n_samples))
    )
    rows, cols = (max(2, round(length / spacing)) for length in (height, width))
    across, down = (east - west) / (cols - 1), (south - north) / (rows - 1)
    transform = Affine(across, 0.0, west, 0.0, down, north)
    return transform, (rows, cols), metres.of(transform)


def heights_on(surface: _Surface, transform: Affine, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the heights of a terrain on a lattice, NaN where it has none."""
    if isinstance(surface, TriangleMesh):
        return surface_at_samples(surface, transform, shape)
    a, _, x, _, e, y = tuple(transform)[:6]
    row, col = np.indices(shape).reshape(2, -1)
    return surface.heights_at(np.column_stack([x + a * col, y + e * row])).reshape(shape)


def sampled(mesh: TriangleMesh, n_samples: int) -> Grid:
    """Return the heights of a mesh on a lattice of about so many samples; void where it has none.

    Raises ValueError where it has none at all, as a mesh that is seen edge-on.
    """
    transform, shape, _ = lattice_over(mesh, n_samples)
    return Grid(surface_at_samples(mesh, transform, shape), transform, mesh.crs)
