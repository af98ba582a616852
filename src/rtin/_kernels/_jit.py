"""The one decorator of all kernels, and where their compiled code is kept."""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

__all__ = ["compiled_before", "inlined", "jit"]

config: Any = numba.core.config


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _fallback_cache() -> str | None:
    """Return a folder of this user's own for compiled kernels, for when Numba finds none.

    Compiled code is loaded from there again, so a folder that anybody else could write to (or
    made before us) is not used: a fresh one, which goes with this process, takes its place. None
    where there is no place for temporary files either.
    """
    try:
        return _own_temporary_folder()
    except OSError:
        return None


def _own_temporary_folder() -> str:
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    folder = Path(tempfile.gettempdir()) / f"rtin-kernels-{user}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    own = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    if stat.S_ISDIR(status.st_mode) and own and not status.st_mode & 0o022:
        return str(folder)
    fresh = tempfile.mkdtemp(prefix="rtin-kernels-")
    atexit.register(shutil.rmtree, fresh, ignore_errors=True)
    return fresh


def _cache_folder() -> str | None:
    """Return the folder to impose on Numba, "" where its own choice works, None for no cache."""
    if config.CACHE_DIR:
        return config.CACHE_DIR if _is_writable(Path(config.CACHE_DIR)) else _fallback_cache()
    in_tree = Path(__file__).parent / "__pycache__"
    # Path.home() would fail for a user without a home, as in some containers.
    user_wide = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "numba")  # noqa: PTH111
    if _is_writable(in_tree) or _is_writable(user_wide):
        return ""
    return _fallback_cache()


_CACHE_FOLDER = _cache_folder()


def jit(function: Callable[..., Any]) -> Any:
    """Compile a kernel on first use, without the GIL, and keep the result on disk if possible."""
    return _compiled(function)


def inlined(function: Callable[..., Any]) -> Any:
    """The same for a part of a kernel, which is put in where it is called.

    Worth it where arrays are passed on: counting references to five of them took 40 ns a call.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    if _CACHE_FOLDER is None:
        return numba.njit(nogil=True, **options)(function)
    before = config.CACHE_DIR
    config.CACHE_DIR = _CACHE_FOLDER or before
    try:
        return numba.njit(cache=True, nogil=True, **options)(function)
    finally:
        config.CACHE_DIR = before


def compiled_before(kernel: Any) -> bool:
    """Return whether the compiled code of ``kernel`` lies on disk, for any argument types."""
    if config.DISABLE_JIT:
        return True
    if _CACHE_FOLDER is None:
        return False
    folder = Path(kernel._cache.cache_path)
    name = f"{kernel.py_func.__qualname__}-{kernel.py_func.__code__.co_firstlineno}"
    return any(folder.glob(f"*.{name}.*.nbi"))
