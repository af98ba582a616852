"""A raster of an island in a level sea, anywhere on Earth, for jobs of tiles."""

import numpy as np
import rasterio
from affine import Affine

STEP = 1.0 / 1200.0  # degrees


def heights_of(shape=(180, 200), seed=5):
    """Heights from 0, all along the border, to some hundred metres; slopes are gentle."""
    rng = np.random.default_rng(seed)
    row, col = (np.linspace(-1.0, 1.0, n) for n in shape)
    heights = np.zeros(shape)
    for wave in range(2, 40):
        a, b = rng.normal(0.0, wave, 2)
        waves = np.sin(a * row[:, None] + b * col + rng.uniform(0.0, 6.3))
        heights += 260.0 / wave * waves
    shore = np.outer(1 - row**4, 1 - col**4)
    return (shore * (350.0 + heights).clip(0.0)).astype(np.float32)


def write_island(path, west=-84.3, north=36.6, **options):
    heights = heights_of(**options)
    with rasterio.open(
        path, "w", driver="GTiff", count=1, dtype="float32", crs="EPSG:4326",
        height=heights.shape[0], width=heights.shape[1],
        transform=Affine(STEP, 0.0, west, 0.0, -STEP, north),
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return path
