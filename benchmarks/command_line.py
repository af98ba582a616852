"""How long the command line takes: help, import, a small raster, the first run ever.

python benchmarks/command_line.py [--repeats N] [--json]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median

from measuring import fractal_terrain, seconds, show

RTIN = [str(Path(sys.executable).with_name("rtin"))]
SMALL = 257


def run(command: list[str], **environment: str) -> Callable[[], object]:
    def call() -> object:
        return subprocess.run(
            command, check=True, capture_output=True, env=os.environ | environment
        )

    return call


def save_small_raster(path: Path) -> None:
    import rasterio
    from affine import Affine

    shape = {"width": SMALL, "height": SMALL, "count": 1, "dtype": "float32"}
    place = {"crs": "EPSG:32628", "transform": Affine(25.0, 0.0, 4e5, 0.0, -25.0, 3e6)}
    with rasterio.open(path, "w", driver="GTiff", **shape, **place) as file:
        file.write(fractal_terrain(SMALL), 1)


def timed(what: str, target: object, call: Callable[[], object], repeats: int) -> dict[str, object]:
    times = [seconds(call) for _ in range(repeats)]
    return {"what": what, "median s": median(times), "least s": min(times), "target s": target}


def rows_in(folder: Path, repeats: int) -> list[dict[str, object]]:
    save_small_raster(folder / "small.tif")
    coarsen = [*RTIN, "coarsen", str(folder / "small.tif"), str(folder / "out.glb")]
    coarsen += ["--max-error", "5"]

    def coarsen_cold() -> object:
        with tempfile.TemporaryDirectory() as cache:
            return run(coarsen, NUMBA_CACHE_DIR=cache)()

    run(coarsen)()
    return [
        timed("python -c pass", "-", run([sys.executable, "-c", "pass"]), repeats),
        timed("import rtin", "-", run([sys.executable, "-c", "import rtin"]), repeats),
        timed("rtin --help", 0.3, run([*RTIN, "--help"]), repeats),
        timed(f"rtin coarsen, {SMALL}²", 1.5, run(coarsen), repeats),
        timed("the same, nothing compiled yet", 20.0, coarsen_cold, 1),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        show({"command line": rows_in(Path(folder), options.repeats)}, options.json)


if __name__ == "__main__":
    main()
