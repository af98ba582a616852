"""Third-party formats and libraries: rasters in, meshes out and in."""

from rtin.io.grids import read_grid
from rtin.io.interchange import from_skfem, from_triangulation, to_skfem, to_triangulation
from rtin.io.meshes import read_mesh, write_mesh

__all__ = [
    "from_skfem",
    "from_triangulation",
    "read_grid",
    "read_mesh",
    "to_skfem",
    "to_triangulation",
    "write_mesh",
]
