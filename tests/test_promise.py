"""`benchmarks/promise.py` evaluates meshes by itself: what it checks holds, and it would notice."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import rtin
from rtin import samples

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "promise.py"


@pytest.fixture(scope="module")
def promise():
    spec = importlib.util.spec_from_file_location("promise", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["jacksboro_fault", "topobathy"])
def test_the_promise_holds_in_memory_and_in_files(promise, name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rtin, "read_grid", lambda _: getattr(samples, name)())
    assert promise.check(f"{name}.tif", tmp_path)
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_the_promise_holds_around_voids_and_for_float64(promise):
    rng = np.random.default_rng(7)
    heights = rng.random((120, 77)).cumsum(axis=0).cumsum(axis=1) + 1e8
    heights[rng.random(heights.shape) < 0.01] = np.nan
    grid = rtin.Grid(heights, (3.0, 1.0, 5e5, 1.0, -3.0, 4.6e6))
    assert grid.heights.dtype == np.float64
    mesh = rtin.coarsen(grid, max_error=1.0)
    error, uncovered = promise.largest_error(mesh, grid)
    assert 0.5 < error <= 1.0 + np.spacing(2e8)
    assert uncovered == rtin.vertical_error(mesh, grid).n_uncovered


def test_a_broken_promise_is_noticed(promise, tmp_path, monkeypatch):
    coarsen = rtin.coarsen
    monkeypatch.setattr(rtin, "read_grid", lambda _: samples.jacksboro_fault())
    monkeypatch.setattr(rtin, "coarsen", lambda grid, max_error: coarsen(grid, threshold=max_error))
    assert not promise.check("jacksboro.tif", tmp_path)
