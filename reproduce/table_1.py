"""Table 1 of the paper: how near RTIN-Coarsening's meshes are to their terrain.

    python reproduce/table_1.py [DEM]

The paper's raster of Gran Canaria is not public. On another one its thresholds lead to other meshes
(the last lines say to which), so meshes of its numbers of vertices are measured instead: by the
paper's threshold, and the least ones by max_error. DEM is any raster that GDAL reads; by default
257² samples of matplotlib's Jacksboro DEM.
"""

from __future__ import annotations

import sys

import rtin
from rtin.studies import accuracy


def main(*dem: str) -> None:
    grid = rtin.read_grid(*dem) if dem else None
    print(accuracy.as_text(accuracy.measure(grid, ["threshold", "rtin"])))


if __name__ == "__main__":
    main(*sys.argv[1:])
