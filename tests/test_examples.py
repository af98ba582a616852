"""The examples run, draw pictures, and find the rates of theory."""

import importlib.util
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rtin import validity

pytest.importorskip("skfem")

EXAMPLES = Path(__file__).parent.parent / "examples"


def load(name):
    """Return an example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # named tuples look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def l_shape():
    return load("l_shape")


@pytest.fixture(scope="module")
def moving_source():
    return load("moving_source")


def run_quick(name, folder):
    command = [sys.executable, "-W", "error", EXAMPLES / f"{name}.py", "--quick", "--json"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [*command, "--out", folder], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout, parse_constant=pytest.fail)


def require_picture(path):
    with Image.open(path) as picture:
        last = getattr(picture, "n_frames", 1) - 1
        for frame in {0, last}:
            picture.seek(frame)
            shades = np.asarray(picture.convert("L"))
            assert min(shades.shape) > 300
            assert shades.std() > 10
        return last + 1


# --- the L-shaped domain ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def converged(tmp_path_factory, l_shape):
    folder = tmp_path_factory.mktemp("l_shape")
    runs = run_quick("l_shape", folder)
    return folder, {
        name: [l_shape.Solved(**one) for one in rounds] for name, rounds in runs.items()
    }


def test_adaptive_refinement_has_the_best_rates_there_are(converged, l_shape):
    _, runs = converged
    assert 0.45 <= l_shape.rate(runs["adaptive"], "energy_error") <= 0.55
    assert 0.9 <= l_shape.rate(runs["adaptive"], "l2_error") <= 1.1


def test_uniform_refinement_has_the_rates_of_the_corner(converged, l_shape):
    _, runs = converged
    assert 0.30 <= l_shape.rate(runs["uniform"], "energy_error") <= 0.37
    assert 0.60 <= l_shape.rate(runs["uniform"], "l2_error") <= 0.74


def test_the_estimate_is_an_error_but_for_a_constant(converged):
    _, runs = converged
    for rounds in runs.values():
        ratios = [one.estimate / one.energy_error for one in rounds[3:]]
        assert max(ratios) < 1.15 * min(ratios)


def test_the_l_shape_is_drawn(converged):
    folder, _ = converged
    assert require_picture(folder / "l_shape.png") == 1


def test_every_mesh_of_the_l_shape_is_valid(l_shape):
    for mark in (l_shape.mark_bulk, l_shape.mark_all):
        _, meshes = l_shape.converge(mark, 500)
        assert len(meshes) >= 4
        for mesh in meshes:
            validity.check(mesh)
            assert mesh.signed_areas().sum() == pytest.approx(3.0, rel=1e-14)


def test_bulk_marking_marks_the_fewest_triangles(l_shape):
    assert l_shape.mark_bulk(np.array([1.0, 5.0, 2.0, 4.0])).tolist() == [False, True, False, True]
    assert l_shape.mark_bulk(np.array([1.0, 6.0, 2.0, 3.0])).tolist() == [False, True, False, False]


def test_the_gradient_is_that_of_the_solution(l_shape):
    x = np.random.default_rng(3).uniform(0.1, 1.0, (2, 50)) * np.array([[-1.0], [1.0]])
    step = 1e-6
    for axis, derivative in enumerate(l_shape.gradient(x)):
        shift = step * np.eye(2)[:, [axis]]
        slope = (l_shape.solution(x + shift) - l_shape.solution(x - shift)) / (2 * step)
        assert derivative == pytest.approx(slope, abs=1e-8)


# --- the moving source --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving_source")
    return folder, run_quick("moving_source", folder)


def test_a_mesh_that_follows_is_as_good_as_a_much_larger_one(followed):
    follows, _, as_small = followed[1]["runs"].values()
    assert follows["error"] < 1.1 * as_small["error"] < 0.02
    assert follows["unknowns"] < as_small["unknowns"] / 5


def test_a_mesh_that_follows_is_better_than_one_as_large_that_stays(followed):
    follows, as_many, _ = followed[1]["runs"].values()
    assert as_many["unknowns"] == pytest.approx(follows["unknowns"], rel=0.1)
    assert as_many["error"] > 5 * follows["error"]


def test_transfers_keep_the_settled_mass(followed):
    mass = followed[1]["mass"]
    assert mass["drift"] <= 1e-12
    assert 0.0 < mass["settled"] < mass["released"]
    assert abs(mass["gained"]) < 1e-3 * mass["released"]


def test_the_plume_is_drawn_and_moves(followed):
    folder, _ = followed
    assert require_picture(folder / "moving_source.png") == 1
    assert require_picture(folder / "moving_source.gif") >= 10


def test_every_mesh_that_follows_is_valid_and_coarsens_too(moving_source):
    moments = list(moving_source.follow(100, 8, moving_source.Clock()))
    for moment in moments:
        validity.check(moment.mesh)
        assert moment.mesh.signed_areas().sum() == pytest.approx(1.0, rel=1e-14)
        assert np.isfinite(moment.fields.u).all()
        assert np.isfinite(moment.fields.settled).all()
        assert abs(moment.drift) <= 1e-12
    left = [
        len(vertices_of(before.mesh) - vertices_of(after.mesh))
        for before, after in itertools.pairwise(moments)
    ]
    assert sum(left) > 100


def vertices_of(mesh):
    return {tuple(place) for place in mesh.vertices.tolist()}


def test_time_steps_keep_the_mass_on_a_mesh_that_stays(moving_source):
    discrete = moving_source.discretise(
        moving_source.uniform(32, moving_source.skfem.ElementTriP1())
    )
    u = np.random.default_rng(5).uniform(size=discrete.basis.N)
    after = moving_source.advance(discrete, u, 0.0)
    step, settling = moving_source.TIME_STEP, moving_source.SETTLING
    total = discrete.mass.sum(axis=0)
    release = moving_source.release(discrete.basis.doflocs, step / 2)
    expected = total @ u + step * (total @ release - settling * total @ (u + after) / 2)
    assert total @ after == pytest.approx(expected, rel=1e-12)
