"""Files are written whole or not at all, and nothing but files is replaced."""

import os
import stat

import pytest

from rtin._atomic import write_bytes


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of POSIX")
def test_a_pipe_or_device_is_not_replaced_by_a_file(tmp_path):
    pipe = tmp_path / "out.ply"
    os.mkfifo(pipe)
    link = tmp_path / "link.ply"
    link.symlink_to(pipe)
    for path in (pipe, link):
        with pytest.raises(OSError, match=r"cannot write .*: it is no regular file"):
            write_bytes(path, b"mesh")
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert sorted(tmp_path.iterdir()) == [link, pipe]


@pytest.mark.skipif(os.name != "posix", reason="permission bits of POSIX")
def test_a_replaced_file_keeps_its_permissions(tmp_path):
    path = tmp_path / "private.ply"
    path.write_bytes(b"old")
    path.chmod(0o600)
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
