"""Compiled kernels are kept where that is possible, and `rtin` works where it is not.

Root may write anywhere: a folder that can't be written to is one whose path leads through a file.
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import rtin

PROGRAM = """
import hashlib, sys
import numpy as np
import rtin
row, col = np.indices((40, 33))
mesh = rtin.coarsen(rtin.Grid(np.float32((row * 37 + col * 91) % 23)), max_error=4)
digest = hashlib.sha256(mesh.vertices.tobytes() + mesh.triangles.tobytes()).hexdigest()
from rtin._kernels.coarsening import settle
print(rtin.__file__, digest, settle._cache.cache_path, sep="\\n")
"""


def expected_digest():
    import numpy as np

    row, col = np.indices((40, 33))
    mesh = rtin.coarsen(rtin.Grid(np.float32((row * 37 + col * 91) % 23)), max_error=4)
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.triangles.tobytes()).hexdigest()


def start(**environment):
    inherited = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("NUMBA_", "XDG_", "COV_", "PYTEST_"))
    }
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        env={**inherited, **{name: str(value) for name, value in environment.items()}},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(process):
    """Where the package came from, the mesh's digest, and the folder of the compiled kernels."""
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert "Warning" not in errors
    package, digest, folder = output.splitlines()
    return Path(package), digest, Path(folder)


@pytest.fixture
def a_file(tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder can be made below this\n")
    return file


@pytest.fixture
def read_only_package(tmp_path):
    """Where to import a copy of the package from, in which Numba can't make its `__pycache__`."""
    source = Path(rtin.__file__).parent
    copy = tmp_path / "site"
    shutil.copytree(source, copy / "rtin", ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "rtin" / "_kernels" / "__pycache__").write_text("a file in the folder's place\n")
    return copy


@pytest.mark.cold
def test_works_where_neither_package_nor_home_can_be_written_to(
    read_only_package, a_file, tmp_path
):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    environment = {
        "PYTHONPATH": read_only_package,
        "HOME": a_file / "home",
        "XDG_CACHE_HOME": a_file / "cache",
        "TMPDIR": scratch,
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    package, digest, folder = finished(start(**environment))
    assert package.is_relative_to(read_only_package)
    assert digest == expected_digest()
    assert folder.is_relative_to(scratch)
    compiled = sorted(scratch.rglob("*.nbc"))
    assert compiled
    before = [file.stat().st_mtime_ns for file in compiled]
    assert finished(start(**environment))[1] == digest
    assert sorted(scratch.rglob("*.nbc")) == compiled  # loaded, not compiled again
    assert [file.stat().st_mtime_ns for file in compiled] == before


@pytest.mark.cold
def test_two_processes_may_start_cold_with_one_folder(tmp_path):
    folder = tmp_path / "kernels"
    results = [finished(process) for process in [start(NUMBA_CACHE_DIR=folder) for _ in range(2)]]
    for _, digest, cache in results:
        assert digest == expected_digest()
        assert cache.is_relative_to(folder)
    assert finished(start(NUMBA_CACHE_DIR=folder))[1] == expected_digest()


@pytest.mark.cold
def test_works_where_the_folder_asked_for_cannot_be_written_to(a_file, tmp_path):
    _, digest, folder = finished(start(NUMBA_CACHE_DIR=a_file / "kernels", TMPDIR=tmp_path))
    assert digest == expected_digest()
    assert folder.is_relative_to(tmp_path)


def fallback_folder(folder):
    """What the package chooses for compiled kernels below a temporary folder."""
    program = "from rtin._kernels import _jit; print(_jit._fallback_cache())"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    return Path(done.stdout.strip())


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="permission bits of POSIX")
def test_loads_no_code_from_a_folder_that_others_may_write_to(tmp_path):
    usual = fallback_folder(tmp_path)
    assert usual == fallback_folder(tmp_path)
    assert usual.stat().st_mode & 0o077 == 0
    usual.chmod(0o777)
    fresh = fallback_folder(tmp_path)
    assert fresh not in (usual, fallback_folder(tmp_path))
    assert not fresh.exists(), "what one process alone uses goes with it"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="permission bits of POSIX")
def test_loads_no_code_through_a_link_or_from_a_file(tmp_path):
    usual = fallback_folder(tmp_path)
    usual.rmdir()
    (tmp_path / "elsewhere").mkdir()
    usual.symlink_to(tmp_path / "elsewhere")
    assert fallback_folder(tmp_path) != usual
    usual.unlink()
    usual.write_text("somebody's file\n")
    assert fallback_folder(tmp_path) != usual


def test_works_without_any_place_for_files(tmp_path):
    program = (
        "import tempfile; tempfile._candidate_tempdir_list = lambda: []\n"
        "from rtin._kernels import _jit\n"
        "print(_jit._fallback_cache())\n"
        "_jit._CACHE_FOLDER = None\n"
        "double = _jit.jit(lambda value: 2 * value)\n"
        "print(double(21), _jit.compiled_before(double))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.split() == ["None", "42", "False"]


def test_bears_a_user_without_a_home(tmp_path):
    program = (
        "import os, pathlib\n"
        "os.environ.pop('HOME', None)\n"
        "def no_home(): raise RuntimeError('no home')\n"
        "pathlib.Path.home = no_home\n"
        "import rtin._kernels._jit"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path)
