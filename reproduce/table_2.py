"""Table 2 of the paper: how near Rational Reducer's meshes are to their terrain.

    python reproduce/table_2.py [DEM]

Rational Reducer is closed source and no longer sold. In its place stands a re-implementation of
what the paper says of it, "angle-merge" of rtin.simplifiers; beside it RTIN-Coarsening to the same
numbers of vertices, which the paper found to be nearer. DEM is as for table_1.py.
"""

from __future__ import annotations

import sys

import rtin
from rtin.studies import accuracy


def main(*dem: str) -> None:
    grid = rtin.read_grid(*dem) if dem else None
    print(accuracy.as_text(accuracy.measure(grid, ["threshold", "angle-merge"])))


if __name__ == "__main__":
    main(*sys.argv[1:])
