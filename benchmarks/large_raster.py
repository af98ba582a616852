"""Write a terrain of any size as a tiled GeoTIFF: python benchmarks/large_raster.py 32769 big.tif.

Noise in octaves, smooth between hashed values on a lattice, each half as high as the one before:
rough at all scales, flat where it would lie below the sea. The same numbers on every machine.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import rasterio
from rasterio.windows import Window

_BLOCK = 512
_HIGHEST = 3000.0
_LONGEST = 4096  # samples between hashed values of the first octave


@numba.njit(nogil=True, cache=True)
def _hashed(row, col, octave):
    """A number from -1 to 1 for a place of an octave's lattice."""
    value = np.uint64(row * 0x9E3779B1 + col * 0x85EBCA77 + octave * 0xC2B2AE3D + 1)
    value ^= value >> np.uint64(33)
    value *= np.uint64(0xFF51AFD7ED558CCD)
    value ^= value >> np.uint64(33)
    value *= np.uint64(0xC4CEB9FE1A85EC53)
    value ^= value >> np.uint64(33)
    return (value >> np.uint64(40)) / 8388608.0 - 1.0


@numba.njit(nogil=True, cache=True)
def _fill(heights, first_row, first_col, longest, highest):
    """Write the heights of a window."""
    n_rows, n_cols = heights.shape
    heights[:] = 0.15 * highest
    step, height, octave = longest, 0.5 * highest, 0
    while step >= 2:
        for i in range(n_rows):
            row = (first_row + i) // step
            t = (first_row + i) % step / step
            t = t * t * (3.0 - 2.0 * t)
            before = -1
            a = b = c = d = 0.0
            for j in range(n_cols):
                col = (first_col + j) // step
                if col != before:
                    before = col
                    a, b = _hashed(row, col, octave), _hashed(row, col + 1, octave)
                    c, d = _hashed(row + 1, col, octave), _hashed(row + 1, col + 1, octave)
                    west, east = a + (c - a) * t, b + (d - b) * t
                s = (first_col + j) % step / step
                heights[i, j] += height * (west + (east - west) * s * s * (3.0 - 2.0 * s))
        step, height, octave = step // 2, 0.5 * height, octave + 1
    for i in range(n_rows):
        for j in range(n_cols):
            heights[i, j] = max(heights[i, j], np.float32(0.0))


def write(path, size, *, compress=None):
    """Write ``size`` × ``size`` samples 30 m apart, float32."""
    profile = {
        "driver": "GTiff", "count": 1, "dtype": "float32", "width": size, "height": size,
        "crs": "EPSG:32632", "transform": rasterio.transform.from_origin(3e5, 5.9e6, 30.0, 30.0),
        "tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK, "bigtiff": "IF_SAFER",
    }  # fmt: skip
    if compress:
        profile |= {"compress": compress, "predictor": 3}

    def strip(first_row):
        heights = np.empty((min(_BLOCK, size - first_row), size), np.float32)
        _fill(heights, first_row, 0, _LONGEST, _HIGHEST)
        return first_row, heights

    with rasterio.open(path, "w", **profile) as raster, ThreadPoolExecutor(2) as pool:
        for first in range(0, size, 4 * _BLOCK):
            rows = range(first, min(first + 4 * _BLOCK, size), _BLOCK)
            for first_row, heights in pool.map(strip, rows):
                raster.write(heights, 1, window=Window(0, first_row, size, len(heights)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("size", type=int)
    parser.add_argument("path", type=Path)
    parser.add_argument("--compress", choices=["deflate", "lzw", "zstd"])
    asked = parser.parse_args()
    write(asked.path, asked.size, compress=asked.compress)
