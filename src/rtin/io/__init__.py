"""Third-party formats: rasters in, meshes out and in."""

from rtin.io.grids import read_grid
from rtin.io.meshes import read_mesh, write_mesh

__all__ = ["read_grid", "read_mesh", "write_mesh"]
