"""Programs of npm that tests run where they are installed: ``npm install --prefix tests``."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

MODULES = Path(__file__).parent / "node_modules"
VALIDATE_GLTF = """
    const validator = require("gltf-validator"), fs = require("fs");
    for (const path of process.argv.slice(1))
        validator.validateBytes(new Uint8Array(fs.readFileSync(path))).then(report =>
            console.log(JSON.stringify([path, report.issues])));
"""


def assert_valid_gltf(paths):
    """Let Khronos's validator read some files; skip where it is not installed."""
    _require("gltf-validator")
    paths = sorted(map(str, paths))
    reports = dict(map(json.loads, _run("-e", VALIDATE_GLTF, *paths).splitlines()))
    assert sorted(reports) == paths
    assert len(paths) > 0
    faulty = {path: issues for path, issues in reports.items() if _n_faults(issues)}
    assert faulty == {}


def assert_valid_3d_tiles(folder):
    """Let Cesium's validator read a tileset and all that it leads to; skip where it is not."""
    _require("3d-tiles-validator")
    report = folder.with_name(f"{folder.name}-report.json")
    main = MODULES / "3d-tiles-validator/build/main"
    _run(str(main), "-t", str(folder / "tileset.json"), "-r", str(report))
    found = json.loads(report.read_text())
    assert _n_faults(found) == 0, found


def _n_faults(report):
    return report["numErrors"] + report["numWarnings"]


def _require(package):
    if shutil.which("node") is None or not (MODULES / package).is_dir():
        pytest.skip(f"{package} is not installed: npm install --prefix tests")


def _run(*arguments):
    done = subprocess.run(
        ["node", *arguments], cwd=MODULES.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
