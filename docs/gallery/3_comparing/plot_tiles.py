"""
A pyramid of tiles
==================

For terrain that is larger than memory, or drawn at many scales: each zoom has four times as many
tiles and half the tolerance. Within a zoom, neighbours share the vertices on their border: no cracks.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import rtin
from rtin import samples

heights = samples.jacksboro_fault().heights[:257, :257]

with tempfile.TemporaryDirectory() as folder:
    np.save(f"{folder}/dem.npy", heights)
    job = rtin.raster_tiles(f"{folder}/dem.npy", "ply", zoom=(0, 3), max_error=[25.0], cells=32)
    summary = job.write(f"{folder}/tiles")
    zooms = [
        [rtin.read_mesh(path) for path in sorted(Path(folder, "tiles", str(zoom)).rglob("*.ply"))]
        for zoom in range(4)
    ]

fig, axes = plt.subplots(1, 4, figsize=(11, 3.3), layout="constrained")
for ax, level, tiles in zip(axes, summary.levels, zooms, strict=True):
    for tile in tiles:
        seen = rtin.to_triangulation(tile)
        ax.tripcolor(seen, tile.vertices[:, 2], cmap="YlGn", vmin=200, vmax=1500)
        ax.triplot(seen, color="#33414d", linewidth=0.2)
        (west, south, _), (east, north, _) = tile.bounds
        ax.plot([west, east, east, west, west], [south, south, north, north, south], "k", lw=0.9)
    ax.set(aspect="equal", xticks=[], yticks=[])
    ax.set_title(
        f"zoom {level.zoom}: {len(tiles)} tile{'s' * (len(tiles) > 1)}, within {level.tolerance:g} m",
        fontsize=10,
    )
plt.show()
