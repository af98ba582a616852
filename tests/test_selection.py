"""Triangles chosen by a condition or by a file."""

import numpy as np
import pytest

import rtin
from rtin import selection
from rtin.mesh import TriangleMesh

# Two level squares of side 1 and 2 at heights 0 and 10, and a triangle rising at 45 degrees.
MESH = TriangleMesh.from_triangles(
    [
        *([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]),
        *([5, 0, 10], [7, 0, 10], [7, 2, 10], [5, 2, 10]),
        *([9, 0, 0], [9, 1, 0], [8, 0, 1]),
    ],
    [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10]],
    tags=[1, 2, 3, 4, 5],
)


@pytest.mark.parametrize(
    ("condition", "chosen"),
    [
        ("z > 5", [2, 3]),
        ("z_max >= 1", [2, 3, 4]),
        ("z_min < z_max", [4]),
        ("area == 2", [2, 3]),
        ("length < 2", [0, 1, 4]),
        ("1.9 < length ** 2 < 2.1", [0, 1, 4]),
        ("44.9 < slope < 45.1", [4]),
        ("slope == 0 and not z == 0", [2, 3]),
        ("x < 1 or tag == 5", [0, 1, 4]),
        ("x < 1 or tag == 5 and y > 0", [0, 1, 4]),
        ("number % 2 == 1", [1, 3]),
        ("-abs(x - 6) > -1", [2, 3]),
        ("hypot(x, y) < 1", [0, 1]),
        ("max(z, x) >= 8 and min(x, z) < 1", [4]),
        ("1 < 2", [0, 1, 2, 3, 4]),
        (" sqrt(area) > 9 / 3 ", []),
    ],
)
def test_a_condition_chooses_triangles(condition, chosen):
    assert np.flatnonzero(selection.where(MESH, condition)).tolist() == chosen


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ("", "a condition such as 'z > 100' is wanted, got ''"),
        ("z >", "a condition such as"),
        ("z = 3", "a condition such as"),
        ("z", "a condition that is true or false is wanted, got 'z'"),
        ("height > 3", "cannot use 'height' in a condition; there are the quantities x, y, z,"),
        ("z > 'a'", "cannot use \"'a'\""),
        ("z > True", "cannot use 'True'"),
        ("__import__('os').system('true')", r"cannot use \"__import__\('os'\).system\('true'\)\""),
        ("open('x')", "cannot use"),
        ("x.__class__ == 3", "cannot use 'x.__class__'"),
        ("[1 for i in x]", "cannot use"),
        ("(lambda: 1)() > 0", "cannot use"),
        ("z if x else y", "cannot use"),
        ("x is y", "cannot use"),
        ("z > 5 & slope < 30", r"cannot use '5 & slope' in a condition; .* and, or, not"),
        ("(z > 5) | (x < 1)", r"cannot use '\(z > 5\) \| \(x < 1\)'"),
        ("~(z > 5)", "cannot use"),
        ("z > 5 and x", "and, or, not want something true or false in a condition, got 'x'"),
        ("not z", "and, or, not want something true or false in a condition, got 'z'"),
        ("abs(x, y) > 0", "abs takes 1 values in a condition, got 2"),
        ("min(x) > 0", "min takes 2 values in a condition, got 1"),
        ("-" * 900 + "1 > 0", "a condition such as"),
        ("(" * 900 + "1" + ")" * 50, "a condition such as"),
        ("1 > 0 " * 200, "a condition has at most 1000 characters, got 1200"),
    ],
)
def test_anything_else_than_a_condition_is_refused(condition, message):
    with pytest.raises(ValueError, match=message):
        selection.where(MESH, condition)


def test_numbers_that_are_too_large_end_at_once():
    assert not selection.where(MESH, "z > 9 ** 9 ** 9 ** 9").any()


def test_a_mesh_without_tags_says_so():
    mesh = TriangleMesh(MESH.vertices, MESH.triangles)
    with pytest.raises(ValueError, match="the mesh has no tags to select triangles by"):
        selection.where(mesh, "tag == 1")


def test_a_list_is_read_from_text_or_npy(tmp_path):
    text = tmp_path / "list.txt"
    text.write_text("# chosen by hand\n3, 1\n\n0 # the first\n")
    assert selection.read_numbers(text).tolist() == [3, 1, 0]
    np.save(tmp_path / "mask.npy", MESH.tags > 2)
    mask = selection.read_numbers(tmp_path / "mask.npy")
    assert rtin.refine(MESH, mask).n_triangles == rtin.refine(MESH, [2, 3, 4]).n_triangles


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", b"1 2\n3 x\n", "numbers of triangles are wanted in .*a.txt, got 'x' on line 2"),
        ("a.txt", b"1.5", "got '1.5' on line 1"),
        ("a.txt", b"-1", "got '-1' on line 1"),
        ("a.txt", b"9" * 30, "on line 1"),
        ("a.txt", b"\xff\xfe\x00", "is neither text nor .npy"),
        ("a.npy", b"\x93NUMPY", "cannot read .*a.npy as .npy"),
        ("a.npy", b"", "cannot read .*a.npy as .npy"),
    ],
)
def test_other_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        selection.read_numbers(tmp_path / name)
