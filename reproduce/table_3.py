"""Table 3 of the paper: the time that RTIN-Coarsening and Rational Reducer take.

    python reproduce/table_3.py [DEM]

The paper's seconds are those of an Athlon of 2.2 GHz. Ours are of one run each, compiled before,
of the simplification alone; "angle merging" in place of Rational Reducer is plain NumPy. DEM is as
for table_1.py.
"""

from __future__ import annotations

import sys

import rtin
from rtin.studies import accuracy


def main(*dem: str) -> None:
    grid = rtin.read_grid(*dem) if dem else None
    print(accuracy.times_as_text(accuracy.measure(grid)))


if __name__ == "__main__":
    main(*sys.argv[1:])
