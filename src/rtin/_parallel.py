"""Bands of rows for a pool of threads, and pools of processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from threading import Thread
from typing import Any

__all__ = ["processes", "row_bands", "run", "thread_count"]

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


def row_bands(
    n_rows: int, most: int = _MOST_BANDS, fewest: int = _FEWEST_ROWS
) -> list[tuple[int, int]]:
    """Return ``(first, end)`` of consecutive bands of rows: the same on any number of threads."""
    n_bands = max(1, min(n_rows // fewest, most))
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


@contextmanager
def processes(number: int) -> Iterator[Executor | None]:
    """Yield a pool of that many processes, None for one: the work is then done here.

    Raises OSError where one of them ends by itself, as when memory runs out.
    """
    if number == 1:
        yield None
        return
    # A fork would take the locks of this process's threads along.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(number, mp_context=context, initializer=_become_worker)
    try:
        yield pool
    except BrokenProcessPool:
        raise OSError(
            "a worker process was ended, perhaps for want of memory; take fewer with --workers"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _become_worker() -> None:
    Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits for us
    os.environ["RTIN_NUM_THREADS"] = "1"


def _end_with_parent() -> None:
    """End this process when the one that waits for it was killed: nobody else would."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
