"""What comparing two surfaces checks, shares out and tells alike, whatever is compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from threading import Lock
from typing import TypeAlias

import numpy as np

from rtin._surfaces import Local, Surface, local_system, numbers_in, surface_of
from rtin.grid import Grid
from rtin.mesh import TriangleMesh

__all__ = ["Progress", "Steps", "shares_of", "two_surfaces"]

Progress: TypeAlias = Callable[[float], None]

_MOST_TASKS = 16
_LARGEST = 1e50  # six such lengths are multiplied, and float64 ends at 1e308


def two_surfaces(
    mesh_a: TriangleMesh | Grid, mesh_b: TriangleMesh | Grid
) -> tuple[Local, Surface, Surface]:
    """Return the local system of two surfaces, and both of them in it.

    Raises
    ------
    TypeError
        If one is neither a TriangleMesh nor a Grid.
    ValueError
        If one has no triangle or a vertex that is not finite, they have unlike CRS, or are larger
        than 1e50.
    """
    for name, given in (("mesh_a", mesh_a), ("mesh_b", mesh_b)):
        _require_surface(name, given)
    if None not in (mesh_a.crs, mesh_b.crs) and mesh_a.crs != mesh_b.crs:
        raise ValueError(
            f"surfaces must have the same CRS, got {_name_of(mesh_a)} and {_name_of(mesh_b)}; "
            "reproject one of them first"
        )
    local = local_system(mesh_a, mesh_b)
    _require_small(local.extent)
    a, b = surface_of(mesh_a, local), surface_of(mesh_b, local)
    for name, surface in (("mesh_a", a), ("mesh_b", b)):
        if surface.n_triangles == 0:
            raise ValueError(
                f"{name} must have triangles, got a grid without three neighbouring heights"
            )
        _require_small(surface.highest)
    return local, a, b


def _require_surface(name: str, surface: TriangleMesh | Grid) -> None:
    if isinstance(surface, Grid):
        return
    if not isinstance(surface, TriangleMesh):
        raise TypeError(f"{name} must be a TriangleMesh or a Grid, got {type(surface).__name__}")
    if surface.n_triangles == 0:
        raise ValueError(f"{name} must have triangles, got a mesh without any")
    numbers = numbers_in(surface)
    is_bad = ~np.isfinite(surface.vertices[numbers]).all(axis=1)
    if is_bad.any():
        bad = int(numbers[is_bad][0])
        raise ValueError(f"{name} must have finite vertices, got {surface.vertices[bad]} at {bad}")


def _require_small(size: float) -> None:
    if not size < _LARGEST:
        raise ValueError(f"surfaces must be smaller than {_LARGEST:g}, got {size:g}")


def _name_of(surface: TriangleMesh | Grid) -> str:
    assert surface.crs is not None
    return surface.crs.to_string()[:40]


def shares_of(n_pieces: int) -> Iterator[range]:
    """Yield consecutive pieces' numbers: the same shares on any number of threads."""
    n_shares = min(_MOST_TASKS, n_pieces)
    for first, end in pairwise([n_pieces * i // n_shares for i in range(n_shares + 1)]):
        yield range(first, end)


class Steps:
    """Counts steps, from any thread, and tells what share of them is done."""

    def __init__(self, tell: Progress | None, n_steps: int) -> None:
        self._tell, self._n_steps, self._n_done, self._lock = tell, n_steps, 0, Lock()

    def step(self) -> None:
        """Count one more."""
        if self._tell is not None:
            with self._lock:
                self._n_done += 1
                self._tell(self._n_done / self._n_steps)
