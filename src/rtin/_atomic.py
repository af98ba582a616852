"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["describing", "replacing", "require_place", "write_bytes"]


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the name of a new file that takes the place of ``path`` once the block succeeds.

    The new file lies in the same folder and has the same extension. Whatever ends the block early,
    an interrupt from the keyboard too, removes it and leaves the file at ``path`` as it was. A
    symbolic link is followed: the file it points to is replaced. Readers see the old file or the
    new one, never a part; the new one has the old one's permissions, or those of any newly created
    file. Devices and pipes are refused: a file would take their place.

    What ends the process at once (SIGTERM, SIGKILL) leaves the new file behind, its name ending in
    .part and the extension. Nothing waits for the disk: a power cut soon after may lose the file.

    Raises
    ------
    OSError
        If the file cannot be written; the class is that of the cause, such as FileNotFoundError
        where the folder does not exist.
    """
    target = Path(os.path.realpath(path))
    part = target.with_name(f".{target.stem}.{secrets.token_hex(4)}.part{target.suffix}")
    _require_place(target, path)
    try:
        with describing(path):
            yield part
            if target.exists():
                part.chmod(stat.S_IMODE(target.stat().st_mode))
            part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def write_bytes(path: str | os.PathLike[str], *chunks: bytes | memoryview) -> None:
    """Write the chunks one after the other to ``path``, whole or not at all.

    Raises
    ------
    OSError
        If the file cannot be written; what was at ``path`` before is still there.
    """
    with replacing(path) as part, part.open("xb") as file:
        for chunk in chunks:
            file.write(chunk)


def require_place(path: str | os.PathLike[str]) -> None:
    """Raise an OSError where no file could be put at ``path``, before the work of writing it."""
    _require_place(Path(os.path.realpath(path)), path)


def _require_place(target: Path, path: str | os.PathLike[str]) -> None:
    wanted = f"cannot write {os.fspath(path)}"
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{wanted}: there is no folder {target.parent}; make it first")
    if target.is_dir():
        raise IsADirectoryError(f"{wanted}: it is a folder; name a file in it")
    if target.exists() and not target.is_file():
        raise OSError(f"{wanted}: it is no regular file; name another")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise PermissionError(f"{wanted}: no permission to write in the folder {target.parent}")


@contextmanager
def describing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Say in every OSError that it was this file that could not be written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        described = type(error)(f"cannot write {os.fspath(path)}: {reason}")
        described.errno = error.errno
        raise described from error
