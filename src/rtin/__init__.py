"""Adaptive right-triangulated terrain meshes, with a guaranteed vertical error.

The names below load their modules on first use, so that ``import rtin`` and ``rtin --help`` stay
quick: Numba alone takes half a second to import.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from rtin._version import __version__

if TYPE_CHECKING:
    from rtin.adaptive import AdaptiveMesh
    from rtin.coarsening import coarsen, coarsen_levels
    from rtin.conformity import Propagation, propagation
    from rtin.criteria import VerticalError, vertex_errors, vertical_error
    from rtin.distance import CertifiedDistance, SurfaceDistance, compare, hausdorff
    from rtin.fitting import fit_heights
    from rtin.grid import Grid
    from rtin.io import (
        from_skfem,
        from_triangulation,
        read_grid,
        read_mesh,
        to_skfem,
        to_triangulation,
        write_mesh,
    )
    from rtin.io.tile_jobs import TileJob, raster_tiles, world_tiles
    from rtin.lod import Frame, LevelOfDetail, frustum
    from rtin.mesh import TriangleMesh
    from rtin.overlay import TerrainDifference, terrain_difference
    from rtin.plotting import plot
    from rtin.refinement import refine, refine_to
    from rtin.viewer.notebook import show

_MODULE_OF = {
    "AdaptiveMesh": "rtin.adaptive",
    "CertifiedDistance": "rtin.distance",
    "Frame": "rtin.lod",
    "Grid": "rtin.grid",
    "LevelOfDetail": "rtin.lod",
    "Propagation": "rtin.conformity",
    "SurfaceDistance": "rtin.distance",
    "TerrainDifference": "rtin.overlay",
    "TileJob": "rtin.io.tile_jobs",
    "TriangleMesh": "rtin.mesh",
    "VerticalError": "rtin.criteria",
    "coarsen": "rtin.coarsening",
    "coarsen_levels": "rtin.coarsening",
    "compare": "rtin.distance",
    "fit_heights": "rtin.fitting",
    "from_skfem": "rtin.io",
    "from_triangulation": "rtin.io",
    "frustum": "rtin.lod",
    "hausdorff": "rtin.distance",
    "plot": "rtin.plotting",
    "propagation": "rtin.conformity",
    "raster_tiles": "rtin.io.tile_jobs",
    "read_grid": "rtin.io",
    "read_mesh": "rtin.io",
    "refine": "rtin.refinement",
    "refine_to": "rtin.refinement",
    "show": "rtin.viewer.notebook",
    "terrain_difference": "rtin.overlay",
    "to_skfem": "rtin.io",
    "to_triangulation": "rtin.io",
    "vertex_errors": "rtin.criteria",
    "vertical_error": "rtin.criteria",
    "world_tiles": "rtin.io.tile_jobs",
    "write_mesh": "rtin.io",
}
_SUBMODULES = ("io", "samples", "validity")

__all__ = [
    "AdaptiveMesh",
    "CertifiedDistance",
    "Frame",
    "Grid",
    "LevelOfDetail",
    "Propagation",
    "SurfaceDistance",
    "TerrainDifference",
    "TileJob",
    "TriangleMesh",
    "VerticalError",
    "__version__",
    "coarsen",
    "coarsen_levels",
    "compare",
    "fit_heights",
    "from_skfem",
    "from_triangulation",
    "frustum",
    "hausdorff",
    "plot",
    "propagation",
    "raster_tiles",
    "read_grid",
    "read_mesh",
    "refine",
    "refine_to",
    "show",
    "terrain_difference",
    "to_skfem",
    "to_triangulation",
    "vertex_errors",
    "vertical_error",
    "world_tiles",
    "write_mesh",
]


def __getattr__(name: str) -> object:
    if name in _SUBMODULES:
        return import_module(f"rtin.{name}")
    if name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'rtin' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_SUBMODULES])
