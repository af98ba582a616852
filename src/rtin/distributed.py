"""The same on Dask: an executor for everything that takes one, on many machines or on this one.

Only cut, call and join: a function and its arguments go to a worker, and what it returns comes
back, in order. Whatever a lost worker had in hand is done again by the others. Results can't
depend on that: they don't depend on any executor.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeVar

from rtin import _parallel
from rtin._number import as_number
from rtin._version import __version__

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as Promise

__all__ = ["ClusterExecutor", "cluster"]

Result = TypeVar("Result")

_IN_FLIGHT = 4  # calls for each thread: so many that none waits, so few that results fit memory


@contextmanager
def cluster(
    scheduler: str | None = None, *, workers: int | None = None, timeout: float = 10.0
) -> Iterator[ClusterExecutor]:
    """Yield an executor on a Dask cluster, and close what was opened in the end.

    Parameters
    ----------
    scheduler : str, optional
        Address of a running scheduler, as tcp://10.0.0.1:8786. It and its workers need the same
        version of rtin, and to see the same files under the same names. They are left running.
    workers : int, optional
        Without a scheduler: processes to start on this machine, one for each processor by default.
        A program that does so needs ``if __name__ == "__main__":``, as with multiprocessing.
    timeout : float
        Seconds to wait for the scheduler, and for its first worker.

    Raises
    ------
    ImportError
        If dask[distributed] is not installed.
    TypeError, ValueError
        If both are given, or ``workers`` is no whole number from 1 on.
    ConnectionError
        If the scheduler can't be reached or has no workers, or lacks this version of rtin.
    OSError
        If one worker after another died at the same part of the work.
    """
    patience = as_number("timeout", timeout)
    if scheduler is None:
        with _quiet(), _here(_as_count(workers)) as client, _one_line():
            yield ClusterExecutor(client)
    elif workers is None:
        with _quiet(), _connected(scheduler, patience) as client, _one_line():
            _require_this_version(client, scheduler, patience)
            yield ClusterExecutor(client)
    else:
        raise ValueError("give a scheduler or a number of workers to start here, not both")


class ClusterExecutor(Executor):
    """A ``concurrent.futures.Executor`` on a ``distributed.Client``.

    Unlike the client's own one, its ``map`` sends a function to a worker once, however much is
    bound to it and however often it is called, and keeps a few calls for each thread of the cluster
    in flight, so that results do not pile up.

    Parameters
    ----------
    client : distributed.Client
        Remains open, and the caller's.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._submitting = client.get_executor(pure=False)

    def submit(self, function: Callable[..., Result], /, *args: Any, **options: Any) -> Future[Any]:  # noqa: ANN401
        """Return the future of one call."""
        future: Future[Any] = self._submitting.submit(partial(function, *args, **options))
        return future

    def map(
        self,
        fn: Callable[..., Result],
        *iterables: Iterable[Any],
        timeout: float | None = None,
        chunksize: int = 1,  # noqa: ARG002  (of processes; here a call is a task)
    ) -> Iterator[Result]:
        """Return ``map(fn, *iterables)``, worked off by the cluster.

        The first calls are under way when this returns; others follow as results are taken, and so
        do their arguments. Closing the iterator cancels what is still to come.

        Raises
        ------
        TimeoutError
            While results are taken: if one takes until more than ``timeout`` seconds from now.
        distributed.KilledWorker
            While results are taken: if one worker after another died at the same call.
        Exception
            While results are taken: whatever a call raised.
        """
        # As a task and not scattered, it is made anew where its worker is lost.
        function = self._client.submit(partial(_unchanged, fn), pure=False)
        upcoming = (
            self._client.submit(partial(_called, arguments), function, pure=False)
            for arguments in zip(*iterables, strict=False)  # as map does: the shortest is the end
        )
        n_threads = sum(self._client.nthreads().values())
        in_flight = deque(islice(upcoming, max(1, n_threads * _IN_FLIGHT)))
        return self._results(
            in_flight, upcoming, None if timeout is None else monotonic() + timeout
        )

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for what was submitted, or cancel it. The client remains open."""
        self._submitting.shutdown(wait=wait and not cancel_futures)

    def _results(
        self, in_flight: deque[Promise[Any]], upcoming: Iterator[Promise[Any]], end: float | None
    ) -> Iterator[Any]:
        try:
            while in_flight:
                left = None if end is None else max(0.0, end - monotonic())
                result = in_flight[0].result(left)
                in_flight.popleft()
                in_flight.extend(islice(upcoming, 1))
                yield result
        finally:
            if self._client.status == "running":
                self._client.cancel(list(in_flight))


def dask_setup(_worker: object) -> None:
    """Leave Ctrl-C to the process that started this worker, which then closes it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _unchanged(function: Callable[..., Result]) -> Callable[..., Result]:
    return function


def _called(arguments: tuple[Any, ...], function: Callable[..., Result]) -> Result:
    return function(*arguments)


# --- clusters -----------------------------------------------------------------------------------


@contextmanager
def _here(n_workers: int) -> Iterator[Client]:
    """Yield a client of workers on this machine: processes of one thread each."""
    distributed = _distributed()
    local = distributed.LocalCluster(
        n_workers=n_workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
        env={"RTIN_NUM_THREADS": "1"},
        preload=__name__,
    )
    with local, distributed.Client(local, set_as_default=False) as client:
        try:
            yield client
        except BaseException:
            _abandon(local.workers.values())
            raise


def _abandon(nannies: Iterable[Any]) -> None:
    """End workers at once: closed in Dask's way, they may finish what they have in hand first."""
    for nanny in nannies:
        nanny.auto_restart = False
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGTERM if os.name == "nt" else signal.SIGKILL)


@contextmanager
def _connected(scheduler: str, patience: float) -> Iterator[Client]:
    client = _client_or_reason(scheduler, patience)
    if isinstance(client, str):
        # A client that failed stops its loop when it is collected, with a lock that the next one
        # takes to start: were it collected meanwhile, both would wait for ever.
        gc.collect()
        raise ConnectionError(
            f"no Dask scheduler can be reached at {scheduler}: {client}; "
            "give its address as it prints it, such as tcp://10.0.0.1:8786"
        )
    with client:
        yield client


def _client_or_reason(scheduler: str, patience: float) -> Client | str:
    """Return a client of a scheduler, or why there is none."""
    try:
        client: Client = _distributed().Client(scheduler, timeout=patience, set_as_default=False)
        return client
    except (OSError, ValueError) as error:
        return str(error).splitlines()[0] if str(error) else type(error).__name__


def _require_this_version(client: Client, scheduler: str, patience: float) -> None:
    """Raise ConnectionError where there is no worker, or one with another version of rtin."""
    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError:
        raise ConnectionError(
            f"the scheduler at {scheduler} has no workers; start some: dask worker {scheduler}"
        ) from None
    try:
        found = {client.run_on_scheduler(_version), *client.run(_version).values()}
    except Exception as error:  # whatever the other side's Python says to a module it lacks
        raise ConnectionError(
            f"the cluster at {scheduler} can't run rtin {__version__} ({error}); install it for "
            f"the scheduler and all workers: pip install 'rtin[dask]=={__version__}'"
        ) from None
    if found != {__version__}:
        raise ConnectionError(
            f"the cluster at {scheduler} runs rtin {' and '.join(sorted(found))}, this is "
            f"{__version__}; install the same version everywhere"
        )


def _version() -> str:
    return __version__


@contextmanager
def _quiet() -> Iterator[None]:
    """Leave it to exceptions to say what went wrong: Dask logs every lost worker."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


@contextmanager
def _one_line() -> Iterator[None]:
    from distributed import KilledWorker

    try:
        yield
    except KilledWorker:
        raise OSError(
            "one worker after another died at the same part of the work, most often for want of "
            "memory; give each worker more, or fewer threads"
        ) from None


def _distributed() -> Any:  # noqa: ANN401
    try:
        import distributed
    except ImportError:
        raise ImportError("rtin.distributed needs dask: pip install 'rtin[dask]'") from None
    return distributed


def _as_count(workers: int | None) -> int:
    if workers is None:
        return _parallel.thread_count()
    if isinstance(workers, bool) or not isinstance(workers, int):
        raise TypeError(f"workers must be a whole number, got {workers!r}")
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    return workers
