"""Bands of rows for a pool of threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

__all__ = ["row_bands", "run", "thread_count"]

_MOST_BANDS = 16
_FEWEST_ROWS = 256


def thread_count() -> int:
    """Return how many threads to use: ``RTIN_NUM_THREADS``, or the processors at hand.

    Raises ValueError where that variable is not a whole number from 1 on. The number never changes
    a result, only the time it takes.
    """
    asked = os.environ.get("RTIN_NUM_THREADS", "")
    if asked:
        if not asked.isdigit() or int(asked) < 1:
            raise ValueError(f"RTIN_NUM_THREADS must be a whole number from 1 on, got {asked!r}")
        return int(asked)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def row_bands(n_rows: int, most: int = _MOST_BANDS) -> list[tuple[int, int]]:
    """Return ``(first, end)`` of consecutive bands of rows: the same on any number of threads."""
    n_bands = max(1, min(n_rows // _FEWEST_ROWS, most))
    edges = [n_rows * i // n_bands for i in range(n_bands + 1)]
    return list(pairwise(edges))


def run(function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Return ``[function(*task) for task in tasks]``, worked off by a pool of threads."""
    tasks = list(tasks)
    if thread_count() == 1 or len(tasks) <= 1:
        return [function(*task) for task in tasks]
    return list(_pool(thread_count()).map(lambda task: function(*task), tasks))


@cache
def _pool(n_threads: int) -> ThreadPoolExecutor:
    # Kept for the life of the process: starting threads anew took longer than a level of a closure.
    return ThreadPoolExecutor(n_threads, thread_name_prefix="rtin")


if hasattr(os, "register_at_fork"):  # a forked child has the pool, but none of its threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
