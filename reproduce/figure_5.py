"""Fig. 5 of the paper: a terrain of 65² samples, coarsened, from above and in perspective.

    python reproduce/figure_5.py [FOLDER [DEM]]

The paper has 1588 vertices and 3063 triangles at a threshold of 15 m. Its raster is not public;
drawn is a mesh of as many vertices, and the title says how many the threshold leaves. Of a larger
DEM the 65² samples with the most relief are taken.
"""

from __future__ import annotations

import sys
from pathlib import Path

import rtin
from rtin.studies import accuracy, accuracy_pictures


def main(folder: str = "figure-5", *dem: str) -> None:
    accuracy_pictures.require_places(Path(folder))
    close = accuracy.close_up(rtin.read_grid(*dem) if dem else None)
    paper, ours = accuracy.FIGURE_5, close.at_count.mesh
    for name, mesh in [("threshold 15", close.at_threshold), ("as many vertices", ours)]:
        print(f"{name:16}: {mesh.n_vertices} vertices, {mesh.n_triangles} triangles")
    print(f"{'the paper':16}: {paper['n_vertices']} vertices, {paper['n_triangles']} triangles")
    print(f"wrote {accuracy_pictures.write_figure_5(close, folder)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
