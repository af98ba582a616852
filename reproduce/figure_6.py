"""Fig. 6 of the paper: meshes by Rational Reducer on the left, by RTIN-Coarsening on the right.

    python reproduce/figure_6.py [FOLDER [DEM]]

Of as many vertices as the paper's, 5750, 1975 and 1094 of 257² samples; "angle merging" stands in
for Rational Reducer. Error against the number of vertices is drawn, too.
"""

from __future__ import annotations

import sys
from pathlib import Path

import rtin
from rtin.studies import accuracy, accuracy_pictures


def main(folder: str = "figure-6", *dem: str) -> None:
    accuracy_pictures.require_places(Path(folder))
    study = accuracy.measure(rtin.read_grid(*dem) if dem else None)
    for line in accuracy.verdict(study):
        print(line)
    for path in accuracy_pictures.write_pictures(study, folder):
        print(f"wrote {path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
