"""What all commands share: progress on stderr, errors in one line, reports on stdout."""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import Annotated, Any

import typer

__all__ = [
    "Json",
    "announce",
    "give_up",
    "interrupt",
    "interrupted",
    "one_line",
    "one_line_errors",
    "progress",
    "progress_bar",
    "report",
    "say",
    "say_if_not_compiled",
]

_QUIET_SECONDS = 1.0
_SECONDS_BETWEEN_LINES = 10.0  # that say what share is done

Json = Annotated[bool, typer.Option("--json", help="Print a JSON summary to stdout.")]
interrupted = threading.Event()


def interrupt(*_: Any) -> None:  # noqa: ANN401
    """Take Ctrl-C down before it ends what is going on: trimesh drops it while it is imported."""
    interrupted.set()
    raise KeyboardInterrupt


def say_if_not_compiled(module: str = "rtin.coarsening", seconds: int = 15) -> None:
    if not import_module(module).is_compiled():
        say(f"first run: compiling, which takes some {seconds} seconds, once for this machine")


def report(summary: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(_finite(summary), allow_nan=False), flush=True)
        return
    for name, value in summary.items():
        if value is not None and value is not False and value != []:
            print(f"{name.replace('_', ' '):>18}  {_readable(value)}")
    sys.stdout.flush()


def _finite(value: Any) -> Any:  # noqa: ANN401
    """Return the same with None for what JSON has no number for."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _readable(value: Any) -> str:  # noqa: ANN401
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {_readable(v)}" for name, v in value.items())
    if isinstance(value, list):
        return (", " if isinstance(value[0], float) else "; ").join(map(_readable, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}" if abs(value) < 1e6 else f"{value:.10g}"
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ")
    return str(value)


def announce(message: str) -> None:
    print(message, flush=True)


def say(message: str) -> None:
    print(f"rtin: {message}", file=sys.stderr, flush=True)


@contextmanager
def progress(what: str) -> Iterator[None]:
    """Say on stderr what is going on, once it has taken more than a second.

    On a terminal a spinner shows that it still does.
    """
    with progress_bar(what):
        yield


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[float], None]]:
    """Do what ``progress`` does; say too what share is done, when told."""
    with ExitStack() as stack:
        shown = _Shown(what, stack)
        timer = threading.Timer(_QUIET_SECONDS, shown.begin)
        timer.daemon = True
        timer.start()
        try:
            yield shown.tell
        finally:
            timer.cancel()
            timer.join()
    if interrupted.is_set():
        raise KeyboardInterrupt


class _Shown:
    """What is seen of work that goes on: a spinner on a terminal, else a line now and then."""

    def __init__(self, what: str, stack: ExitStack) -> None:
        self._what, self._stack = what, stack
        self._update: Callable[[float], None] | None = None
        self._began = time.monotonic()
        self._said = math.inf

    def begin(self) -> None:
        if not sys.stderr.isatty():
            say(f"{self._what} …")
            self._said = time.monotonic()
            return
        from rich.console import Console
        from rich.progress import (
            Progress,
            SpinnerColumn,
            TaskProgressColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        progress = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), TaskProgressColumn(),
            TimeElapsedColumn(), TimeRemainingColumn(),
            console=Console(stderr=True), transient=True,
        )  # fmt: skip
        self._stack.enter_context(progress)
        task = progress.add_task(f"rtin: {self._what} …", total=None)
        self._update = lambda share: progress.update(task, total=1.0, completed=share)

    def tell(self, share: float) -> None:
        if self._update is not None:
            self._update(share)
        elif time.monotonic() - self._said > _SECONDS_BETWEEN_LINES:
            self._said = time.monotonic()
            left = (self._said - self._began) * (1.0 / share - 1.0) if share > 0.0 else math.inf
            about = f", about {left:.0f} s left" if left < math.inf else ""
            say(f"{self._what}: {100 * share:.0f} %{about}")


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn a failure into one line on stderr and exit code 1; RTIN_DEBUG=1 shows the traceback."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: say(one_line(message))
            yield
    except (typer.Exit, typer.BadParameter):
        raise
    except Exception as error:
        if interrupted.is_set():
            raise KeyboardInterrupt from None
        if os.environ.get("RTIN_DEBUG"):
            raise
        give_up(error)
        raise typer.Exit(1) from None


def give_up(error: Exception) -> None:
    """Say what failed, and let go of a stdout that can't be written to.

    Python would complain of it again when it ends. That nobody reads on (``| head``) is no news.
    """
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if not isinstance(error, BrokenPipeError):
        expected = isinstance(
            error, OSError | ValueError | TypeError | IndexError | MemoryError | ImportError
        )
        say(one_line(error) if expected else f"{type(error).__name__}: {one_line(error)}")


def one_line(error: BaseException | str) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'cannot write to stdout'}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"not enough memory: ask for fewer triangles or samples ({error})".replace(" ()", "")
    return " ".join(str(error).split()) or type(error).__name__
