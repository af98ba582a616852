"""What the benchmarks share: terrains, fair timing, and tables."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

Heights = NDArray[np.float32]


def fractal_terrain(rows: int, cols: int | None = None, roughness: float = 2.0) -> Heights:
    """Return 0 to 3000 m of terrain whose spectrum falls as frequency ** -roughness."""
    shape = (rows, cols or rows)
    noise = np.random.default_rng(2024).standard_normal(shape).astype(np.float32)
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])
    frequency[0, 0] = np.inf
    terrain = np.fft.irfft2(np.fft.rfft2(noise) * frequency**-roughness, shape)
    terrain -= terrain.min()
    return (terrain * (3000.0 / terrain.max())).astype(np.float32)


@dataclass(frozen=True)
class Duel:
    """Seconds of two functions that took turns, and processor seconds over all threads."""

    ours: list[float]
    theirs: list[float]
    ours_cpu: list[float]
    theirs_cpu: list[float]

    @property
    def ratio(self) -> float:
        """How many times as long as ours theirs takes: the median over the turns."""
        return median(b / a for a, b in zip(self.ours, self.theirs, strict=True))

    @property
    def ratio_of_best(self) -> float:
        """The same for the quickest turn of each."""
        return min(self.theirs) / min(self.ours)

    @property
    def ratio_of_work(self) -> float:
        """The same in processor time: what one core alone would show, whatever else runs."""
        return min(self.theirs_cpu) / min(self.ours_cpu)


def seconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def seconds_and_cpu(function: Callable[[], object]) -> tuple[float, float]:
    cpu = time.process_time()
    wall = seconds(function)
    return wall, time.process_time() - cpu


def duel(ours: Callable[[], object], theirs: Callable[[], object], repeats: int) -> Duel:
    """Time both in turns, after one warm-up turn each."""
    ours()
    theirs()
    turns = [seconds_and_cpu(ours) + seconds_and_cpu(theirs) for _ in range(repeats)]
    our_wall, our_cpu, their_wall, their_cpu = (list(times) for times in zip(*turns, strict=True))
    return Duel(our_wall, their_wall, our_cpu, their_cpu)


def median_seconds(function: Callable[[], object], repeats: int) -> float:
    function()
    return median(seconds(function) for _ in range(repeats))


def milliseconds(value: float) -> float:
    return round(1e3 * value, 2)


def show(tables: dict[str, list[dict[str, object]]], as_json: bool) -> None:
    """Print tables, each a list of rows of the same keys, for people or for programs."""
    if as_json:
        print(json.dumps(tables, indent=1))
        return
    console = Console(width=150)
    for title, rows in tables.items():
        table = Table(title=title, title_justify="left")
        for name in rows[0] if rows else ():
            table.add_column(name, justify="right" if name != "raster" else "left")
        for row in rows:
            table.add_row(*(_text(value) for value in row.values()))
        console.print(table)


def _text(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ")
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
