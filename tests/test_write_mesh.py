import json
import os
import re
import signal
import stat
import subprocess
import sys
import tracemalloc
from fractions import Fraction
from pathlib import Path

import meshio
import numpy as np
import pyproj
import pytest
import pyvista
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hand_meshes import bumpy, in_degrees, in_utm, touching_at_a_point, with_hole
from rtin._atomic import replacing, write_bytes
from rtin.grid import Grid
from rtin.io import _gltf
from rtin.io.meshes import (
    is_mesh_path,
    placement_of,
    read_mesh,
    require_writable,
    write_mesh,
)
from rtin.io.solid import close
from rtin.mesh import TriangleMesh

EXACT = [".obj", ".ply", ".vtu", ".vtp", ".msh", ".xdmf", ".2dm"]
WITH_CRS = [".glb", *EXACT]
READABLE = [*WITH_CRS, ".stl"]
WRITABLE = [*READABLE, ".html"]

# What each format may add, in metres, over the 240 m of the meshes here, at heights below 512.
ROUNDING = {".glb": 240 / 3e7, ".stl": 240 / 3e7} | dict.fromkeys(EXACT, 0.0)


def round_trip(mesh, path, **options):
    write_mesh(mesh, path, **options)
    return read_mesh(path)


def glb_json(path):
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + length])


def read_independently(path):
    """Vertices (z up, as in the file) and triangles, by a program that is not ours."""
    if path.suffix in (".vtu", ".ply", ".msh", ".xdmf"):
        mesh = meshio.read(path)
        return mesh.points, mesh.cells_dict["triangle"]
    if path.suffix == ".2dm":  # by the format's description: no library that is kept up reads it
        cards = [line.split() for line in path.read_text().splitlines()]
        points = np.array([card[2:5] for card in cards if card[0] == "ND"], dtype=float)
        return points, np.array([card[2:5] for card in cards if card[0] == "E3T"], dtype=int) - 1
    if path.suffix == ".vtp":
        mesh = pyvista.read(path)
        return mesh.points, mesh.faces.reshape(-1, 4)[:, 1:]
    mesh = trimesh.load_mesh(path, process=False)
    points = np.array(mesh.vertices)
    if path.suffix == ".glb":
        points = np.column_stack([points[:, 0], -points[:, 2], points[:, 1]])
    return points, np.array(mesh.faces)


# Round trips


@pytest.mark.parametrize("suffix", WITH_CRS)
@pytest.mark.parametrize("shape", [bumpy, with_hole, touching_at_a_point, in_utm])
def test_reading_gives_back_what_was_written(shape, suffix, tmp_path):
    mesh = shape()
    back = round_trip(mesh, tmp_path / f"mesh{suffix}")
    np.testing.assert_array_equal(back.triangles, mesh.triangles)
    np.testing.assert_allclose(back.vertices, mesh.vertices, rtol=0, atol=ROUNDING[suffix] + 1e-9)
    assert back.crs == mesh.crs


@pytest.mark.parametrize("suffix", EXACT)
@pytest.mark.parametrize("height", [1.0, 1e-7, 1e-300, 1e300])
def test_text_and_64_bit_formats_round_nothing(height, suffix, tmp_path):
    utm = in_utm()
    mesh = TriangleMesh(utm.vertices * [1.0, 1.0, height / 3.0], utm.triangles, utm.crs)
    back = round_trip(mesh, tmp_path / f"mesh{suffix}")
    np.testing.assert_array_equal(back.vertices, mesh.vertices)


@pytest.mark.parametrize("suffix", WITH_CRS)
def test_reading_undoes_metres_and_z_scale(suffix, tmp_path):
    mesh = in_degrees()
    back = round_trip(mesh, tmp_path / f"mesh{suffix}", z_scale=2.5)
    tolerance = ROUNDING[suffix] + 1e-6
    np.testing.assert_allclose(back.vertices[:, :2], mesh.vertices[:, :2], atol=tolerance / 8e4)
    np.testing.assert_allclose(back.vertices[:, 2], mesh.vertices[:, 2], atol=2e-5)
    np.testing.assert_array_equal(back.triangles, mesh.triangles)
    assert back.crs == mesh.crs


@pytest.mark.parametrize("suffix", WITH_CRS)
def test_reading_gives_back_degrees_that_were_kept(suffix, tmp_path):
    mesh = in_degrees()
    back = round_trip(mesh, tmp_path / f"mesh{suffix}", keep_degrees=True)
    np.testing.assert_allclose(back.vertices[:, :2], mesh.vertices[:, :2], rtol=0, atol=1e-9)


@pytest.mark.parametrize("suffix", WITH_CRS)
def test_reading_gives_back_a_solid_with_its_bottom(suffix, tmp_path):
    mesh = with_hole()
    back = round_trip(mesh, tmp_path / f"mesh{suffix}", base=10.0)
    np.testing.assert_array_equal(back.triangles, close(mesh, 10.0).triangles)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(
    st.sampled_from([".glb", ".ply"]),
    st.floats(-1e7, 1e7),
    st.floats(-1e7, 1e7),
    st.floats(1e-2, 1e4),
    st.floats(0.1, 10.0),
)
def test_round_trips_hold_anywhere(tmp_path_factory, suffix, west, north, step, z_scale):
    mesh = bumpy(west=west, north=north, step=step)
    path = tmp_path_factory.mktemp("anywhere") / f"mesh{suffix}"
    back = round_trip(mesh, path, z_scale=z_scale)
    in_doubles = 4 * np.spacing(max(abs(west), abs(north), 8 * step))
    rounding = 8 * step / 3e7 if suffix == ".glb" else 0.0
    np.testing.assert_allclose(
        back.vertices[:, :2], mesh.vertices[:, :2], rtol=0, atol=rounding + in_doubles
    )
    np.testing.assert_allclose(back.vertices[:, 2], mesh.vertices[:, 2], rtol=2**-23)


def test_glb_keeps_the_millimetres_of_utm_coordinates(tmp_path):
    mesh = bumpy(40, 40, crs="EPSG:32616", west=500_000.123, north=4_600_000.456, step=777.7)
    back = round_trip(mesh, tmp_path / "mesh.glb")
    np.testing.assert_allclose(back.vertices, mesh.vertices, rtol=0, atol=1e-3)


def test_glb_keeps_float32_heights_exactly(tmp_path):
    heights = np.random.default_rng(1).uniform(0, 9000, (7, 9)).astype(np.float32)
    mesh = bumpy(heights=heights, crs="EPSG:32616")
    back = round_trip(mesh, tmp_path / "mesh.glb")
    np.testing.assert_array_equal(back.vertices[:, 2], mesh.vertices[:, 2])


def test_stl_merges_its_soup_and_counts_from_the_middle(tmp_path):
    mesh = in_utm()
    back = round_trip(mesh, tmp_path / "mesh.stl")
    assert (back.n_vertices, back.n_triangles) == (mesh.n_vertices, mesh.n_triangles)
    assert back.crs is None
    origin = placement_of(mesh, "mesh.stl").origin
    assert_same_triangles(back, mesh, origin, ROUNDING[".stl"])


def assert_same_triangles(back, mesh, origin, tolerance):
    ours = (mesh.vertices - origin)[mesh.triangles]
    theirs = back.vertices[back.triangles]
    np.testing.assert_allclose(np.sort(theirs, axis=1), np.sort(ours, axis=1), atol=tolerance)


# What other programs find


@pytest.mark.parametrize("suffix", READABLE)
@pytest.mark.parametrize("shape", [in_utm, in_degrees])
def test_other_programs_find_the_placed_mesh(shape, suffix, tmp_path):
    mesh = shape()
    path = tmp_path / f"mesh{suffix}"
    write_mesh(mesh, path, z_scale=2.0)
    points, triangles = read_independently(path)
    placed = placement_of(mesh, path, z_scale=2.0)
    expected = (mesh.vertices - placed.origin) * placed.scale
    np.testing.assert_allclose(
        points[triangles], expected[mesh.triangles], rtol=0, atol=ROUNDING[suffix] + 2e-5
    )


def test_geographic_meshes_are_in_metres(tmp_path):
    mesh = in_degrees()
    write_mesh(mesh, tmp_path / "mesh.ply")
    points, _ = read_independently(tmp_path / "mesh.ply")
    geod = mesh.crs.get_geod()
    (west, south, _), (east, north, _) = mesh.bounds
    latitude, longitude = (south + north) / 2, (west + east) / 2
    width = geod.inv(west, latitude, east, latitude)[2]
    height = geod.inv(longitude, south, longitude, north)[2]
    np.testing.assert_allclose(np.ptp(points, axis=0)[:2], [width, height], rtol=1e-5)


def test_lengths_on_the_moon_are_the_moons():
    moon = "+proj=longlat +R=1737400 +no_defs"
    mesh = bumpy(crs=moon, west=-0.5, north=0.5, step=0.1)
    assert placement_of(mesh, "a.glb").scale[1] == pytest.approx(1737400 * np.pi / 180)


def test_glb_is_y_up_and_its_node_has_a_translation(tmp_path):
    mesh = in_utm()
    write_mesh(mesh, tmp_path / "mesh.glb")
    (node,) = glb_json(tmp_path / "mesh.glb")["nodes"]
    x, y, _ = mesh.bounds.mean(axis=0)
    np.testing.assert_allclose(node["translation"], [x, 0.0, -y])
    assert "matrix" not in node


def test_glb_drapes_a_picture_with_north_at_its_top(tmp_path):
    write_mesh(bumpy(), tmp_path / "mesh.glb")
    (mesh,) = trimesh.load_scene(tmp_path / "mesh.glb", process=False).geometry.values()
    x, y_south = mesh.vertices[:, 0], mesh.vertices[:, 2]
    u, v_from_bottom = mesh.visual.uv.T
    np.testing.assert_allclose(u, (x - x.min()) / np.ptp(x), atol=1e-6)
    np.testing.assert_allclose(1.0 - v_from_bottom, (y_south - y_south.min()) / 180.0, atol=1e-6)


def test_glb_has_unit_normals_that_point_up(tmp_path):
    write_mesh(in_utm(), tmp_path / "mesh.glb")
    (mesh,) = trimesh.load_scene(tmp_path / "mesh.glb", process=False).geometry.values()
    stored = np.array(mesh.vertex_normals)
    np.testing.assert_allclose(np.linalg.norm(stored, axis=1), 1.0, atol=1e-6)
    assert (stored[:, 1] > 0.0).all()
    sums = np.zeros_like(stored)
    for corner in mesh.faces.T:
        np.add.at(sums, corner, mesh.face_normals * mesh.area_faces[:, None])
    np.testing.assert_allclose(stored, trimesh.unitize(sums), atol=1e-4)


def test_glb_of_a_solid_has_no_normals(tmp_path):
    write_mesh(bumpy(), tmp_path / "mesh.glb", base=10.0)
    (primitive,) = glb_json(tmp_path / "mesh.glb")["meshes"][0]["primitives"]
    assert set(primitive["attributes"]) == {"POSITION", "COLOR_0", "TEXCOORD_0"}


def test_glb_is_matt_and_tinted_from_low_to_high(tmp_path):
    write_mesh(bumpy(), tmp_path / "mesh.glb")
    tree = glb_json(tmp_path / "mesh.glb")
    pbr = tree["materials"][0]["pbrMetallicRoughness"]
    assert (pbr["metallicFactor"], pbr["roughnessFactor"]) == (0.0, 1.0)
    (mesh,) = trimesh.load_scene(tmp_path / "mesh.glb", process=False).geometry.values()
    brightness = mesh.visual.vertex_attributes["color"][:, :3].sum(axis=1)
    heights = bumpy().vertices[:, 2]
    assert brightness[heights.argmax()] > 1.5 * brightness[heights.argmin()]


def test_glb_says_what_each_part_of_its_buffer_is_for(tmp_path):
    mesh = bumpy()
    write_mesh(mesh, tmp_path / "mesh.glb")
    tree = glb_json(tmp_path / "mesh.glb")
    targets = [view["target"] for view in tree["bufferViews"]]
    assert targets == [34963, 34962, 34962, 34962, 34962]
    (primitive,) = tree["meshes"][0]["primitives"]
    assert tree["accessors"][primitive["indices"]]["count"] == 3 * mesh.n_triangles
    ends = [view["byteOffset"] + view["byteLength"] for view in tree["bufferViews"]]
    assert ends[-1] == tree["buffers"][0]["byteLength"]
    assert not [end for end in ends if end % 4]


def test_glb_states_the_bounds_of_its_positions_exactly(tmp_path):
    mesh = in_utm()
    write_mesh(mesh, tmp_path / "mesh.glb")
    position = glb_json(tmp_path / "mesh.glb")["accessors"][1]
    (part,) = trimesh.load_scene(tmp_path / "mesh.glb", process=False).geometry.values()
    assert [position["min"], position["max"]] == part.bounds.tolist()


def test_a_glb_that_would_not_fit_its_32_bit_lengths_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(_gltf, "_LONGEST_FILE", 4000)
    with pytest.raises(ValueError, match=r"at most 4,000 bytes, .* 4,896; write a \.ply"):
        write_mesh(bumpy(), tmp_path / "mesh.glb")
    assert not list(tmp_path.iterdir())


def test_glb_names_the_crs_in_its_extras(tmp_path):
    write_mesh(in_degrees(), tmp_path / "mesh.glb")
    assert glb_json(tmp_path / "mesh.glb")["meshes"][0]["extras"]["rtin"]["crs"] == "EPSG:4326"


@pytest.mark.parametrize("suffix", WITH_CRS)
def test_a_crs_that_no_authority_lists_is_kept(suffix, tmp_path):
    crs = "+proj=tmerc +lat_0=36.5 +lon_0=-84.25 +k=1 +x_0=1000 +y_0=0 +ellps=GRS80 +units=m"
    mesh = bumpy(crs=crs)
    assert round_trip(mesh, tmp_path / f"mesh{suffix}").crs == mesh.crs


def test_a_crs_is_named_only_where_the_name_means_exactly_it(tmp_path):
    # PROJ is sure that this is EPSG:4326, but its axes are in another order.
    esri = pyproj.CRS(pyproj.CRS("EPSG:4326").to_wkt("WKT1_ESRI"))
    assert esri != pyproj.CRS("EPSG:4326")
    assert round_trip(bumpy(crs=esri), tmp_path / "mesh.ply").crs == esri


# Placement


def test_placement_says_what_happens_to_degrees():
    mesh = bumpy(31, 41, crs="EPSG:4326", west=-84.35, north=36.665, step=0.005)
    assert placement_of(mesh, "a.glb").note == (
        "x and y scaled from degrees to metres around 36.59 N 84.25 W"
    )


ROTATED_POLE = "+proj=ob_tran +o_proj=longlat +o_lon_p=-162 +o_lat_p=39.25 +lon_0=180 +R=6371229"


def test_placement_names_no_place_on_a_globe_that_is_turned():
    mesh = bumpy(31, 41, crs=ROTATED_POLE, west=1.0, north=2.0, step=0.01)
    assert placement_of(mesh, "a.glb").note == (
        "x and y scaled from degrees to metres around x = 1.2, y = 1.85 of the CRS"
    )


@pytest.mark.parametrize("suffix", WITH_CRS)
def test_a_crs_on_a_globe_that_is_turned_is_kept(suffix, tmp_path):
    mesh = bumpy(crs=ROTATED_POLE, west=1.0, north=2.0, step=0.01)
    assert round_trip(mesh, tmp_path / f"mesh{suffix}").crs == mesh.crs


def test_placement_says_nothing_where_nothing_happens():
    assert placement_of(in_utm(), "a.glb").note == ""
    assert placement_of(in_degrees(), "a.obj", keep_degrees=True).note == ""


def test_placement_says_that_stl_counts_from_the_middle():
    assert placement_of(in_utm(), "a.stl").note.startswith("x and y are measured from 500120.1, ")


# Files of other programs


def test_a_foreign_mesh_is_put_into_our_order(tmp_path):
    square = np.array([[0, 0, 1], [4, 0, 2], [4, 4, 3], [0, 4, 4]], dtype=float)
    upside_down = [[2, 1, 0], [3, 2, 0]]
    trimesh.Trimesh(square, upside_down, process=False).export(tmp_path / "foreign.ply")
    mesh = read_mesh(tmp_path / "foreign.ply")
    expected = TriangleMesh.from_triangles(square, upside_down)
    np.testing.assert_array_equal(mesh.vertices, square)
    np.testing.assert_array_equal(mesh.triangles, expected.triangles)
    assert (mesh.signed_areas() > 0).all()


def test_a_foreign_obj_with_quads_is_cut_into_triangles(tmp_path):
    lines = ["v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "f 1 2 3 4"]
    (tmp_path / "quad.obj").write_text("\n".join(lines))
    assert read_mesh(tmp_path / "quad.obj").n_triangles == 2


@pytest.mark.parametrize("suffix", [".vtp", ".vtu"])
def test_a_foreign_vtk_file_with_quads_is_cut_into_triangles(suffix, tmp_path):
    plane = pyvista.Plane(i_resolution=3, j_resolution=2)
    shape = plane if suffix == ".vtp" else plane.cast_to_unstructured_grid()
    shape.save(tmp_path / f"quads{suffix}")
    mesh = read_mesh(tmp_path / f"quads{suffix}")
    assert (mesh.n_triangles, mesh.n_vertices) == (12, 12)


def test_a_foreign_glb_is_turned_z_up_and_put_together(tmp_path):
    mesh = bumpy()
    y_up = np.column_stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]])
    scene = trimesh.Scene()
    for shift in (0.0, 1000.0):
        part = trimesh.Trimesh(y_up, mesh.triangles, process=False)
        scene.add_geometry(part, transform=trimesh.transformations.translation_matrix([shift] * 3))
    scene.export(tmp_path / "foreign.glb")
    back = read_mesh(tmp_path / "foreign.glb")
    assert back.n_triangles == 2 * mesh.n_triangles
    shifted = mesh.vertices + np.array([1000.0, -1000.0, 1000.0])
    parts = sorted(np.split(back.vertices, 2), key=lambda part: part[0, 0])
    np.testing.assert_allclose(parts, [mesh.vertices, shifted], atol=1e-4)
    np.testing.assert_array_equal(np.unique(back.triangles), np.arange(2 * mesh.n_vertices))


def test_a_glb_that_another_program_changed_keeps_its_place_but_not_our_order(tmp_path):
    mesh = in_degrees()
    write_mesh(mesh, tmp_path / "mesh.glb")
    scene = trimesh.load_scene(tmp_path / "mesh.glb", process=False)
    (part,) = scene.geometry.values()
    part.faces = part.faces[5:, ::-1]
    scene.export(tmp_path / "changed.glb")
    back = read_mesh(tmp_path / "changed.glb")
    assert back.crs == mesh.crs
    assert back.n_triangles == mesh.n_triangles - 5
    assert (back.signed_areas() > 0).all()
    np.testing.assert_allclose(back.bounds, mesh.bounds, atol=1e-7)


# Errors


def test_an_unknown_extension_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"\.glb, .*\.html, got '\.gltf' in mesh\.gltf"):
        write_mesh(bumpy(), "mesh.gltf")
    with pytest.raises(ValueError, match=r"\.glb, .*\.2dm, got '\.html' in mesh\.html"):
        read_mesh("mesh.html")
    with pytest.raises(ValueError, match="got 'none'"):
        placement_of(bumpy(), "mesh")


@pytest.mark.parametrize("suffix", [".GLB", ".Ply"])
def test_extensions_may_be_in_capitals(suffix, tmp_path):
    assert round_trip(bumpy(), tmp_path / f"mesh{suffix}").n_triangles == bumpy().n_triangles


@pytest.mark.parametrize("z_scale", [0.0, -1.0, np.nan, np.inf])
def test_a_z_scale_that_is_not_more_than_zero_is_refused(z_scale, tmp_path):
    with pytest.raises(ValueError, match="z_scale must be more than zero"):
        write_mesh(bumpy(), tmp_path / "mesh.glb", z_scale=z_scale)


@pytest.mark.parametrize("suffix", [".glb", ".stl", ".html"])
@pytest.mark.parametrize("options", [{"z_scale": 1e38}, {"base": 1e39}])
def test_numbers_that_32_bits_do_not_hold_are_refused(suffix, options, tmp_path):
    with pytest.raises(
        ValueError, match=r"32-bit .* up to 1e\+38, .* reaches [13]\.?\d*e\+\d\d$"
    ) as caught:
        write_mesh(in_utm(), tmp_path / f"mesh{suffix}", **options)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", WRITABLE)
def test_numbers_that_64_bits_do_not_hold_are_refused(suffix, tmp_path):
    with pytest.raises(ValueError, match="inf"):
        write_mesh(in_utm(), tmp_path / f"mesh{suffix}", z_scale=1e308)
    assert not list(tmp_path.iterdir())


def test_what_is_no_mesh_is_refused(tmp_path):
    grid = Grid([[0.0, 1.0], [2.0, 3.0]])
    for write in (write_mesh, placement_of):
        with pytest.raises(TypeError, match=r"^a TriangleMesh is wanted, got Grid$"):
            write(grid, tmp_path / "mesh.glb")
    with pytest.raises(TypeError, match=r"^a TriangleMesh is wanted, got str$"):
        write_mesh("mesh.glb", bumpy())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["z_scale", "base"])
@pytest.mark.parametrize("value", ["2", [1.0, 2.0], True, 1j, b"2"])
def test_options_that_are_no_numbers_are_refused(name, value, tmp_path):
    message = re.escape(f"{name} must be a number, got {value!r}")
    with pytest.raises(TypeError, match=f"^{message}$"):
        write_mesh(bumpy(), tmp_path / "mesh.glb", **{name: value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [2, np.float32(2), np.int16(2), Fraction(2)])
def test_numbers_of_any_kind_will_do(number, tmp_path):
    back = round_trip(bumpy(), tmp_path / "mesh.ply", z_scale=number, base=number)
    np.testing.assert_allclose(back.bounds[0, 2], bumpy().bounds[0, 2] - 1.0)


def test_an_empty_mesh_and_infinite_vertices_are_refused(tmp_path):
    with pytest.raises(ValueError, match="without any"):
        write_mesh(TriangleMesh([[0, 0, 0]], np.empty((0, 3), int)), tmp_path / "mesh.glb")
    with pytest.raises(ValueError, match="finite"):
        write_mesh(TriangleMesh([[0, 0, np.nan]], [[0, 0, 0]]), tmp_path / "mesh.glb")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", READABLE)
def test_a_file_that_is_not_there_is_not_found(suffix, tmp_path):
    with pytest.raises(FileNotFoundError):
        read_mesh(tmp_path / f"nothing{suffix}")


@pytest.mark.parametrize("suffix", READABLE)
@pytest.mark.parametrize("content", [b"", b"garbage\n", bytes(range(256)) * 9])
def test_a_broken_file_is_told_in_one_line(suffix, content, tmp_path, capfd):
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    with pytest.raises((OSError, ValueError), match="broken") as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("suffix", READABLE)
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_a_file_that_is_cut_short_is_not_read_as_whole(suffix, part, tmp_path):
    path = tmp_path / f"cut{suffix}"
    write_mesh(bumpy(20, 20), path)
    path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])
    with pytest.raises((OSError, ValueError), match="cut"):
        read_mesh(path)


def with_json(glb, change):
    """The same GLB after ``change`` has been at its JSON."""
    length = int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20 : 20 + length])
    change(tree)
    text = json.dumps(tree).encode()
    return glb[:12] + len(text).to_bytes(4, "little") + b"JSON" + text + glb[20 + length :]


def test_a_glb_that_announces_what_it_does_not_hold_costs_no_memory(tmp_path):
    path = tmp_path / "mesh.glb"
    write_mesh(bumpy(), path)

    def announce(tree):
        del tree["accessors"][1]["bufferView"]
        tree["accessors"][1]["count"] = 300_000_000

    path.write_bytes(with_json(path.read_bytes(), announce))
    with pytest.raises(OSError, match=r"mesh\.glb as GLB: 300,000,\d* values are announced in"):
        read_mesh(path)


@pytest.mark.parametrize("chunk", ["JSON", "BIN"])
def test_a_glb_whose_chunk_is_said_to_be_gigabytes_costs_no_memory(chunk, tmp_path):
    path = tmp_path / "mesh.glb"
    write_mesh(bumpy(), path)
    content = bytearray(path.read_bytes())
    content[content.index(chunk.encode()) - 1] = 0xFF
    path.write_bytes(content)
    tracemalloc.start()
    try:
        assert not read_or_refuse(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("suffix", "name"),
    [(".vtu", "NumberOfPoints"), (".vtu", "NumberOfCells"), (".vtp", "NumberOfPolys")],
)
def test_a_vtk_file_that_announces_what_it_does_not_hold_costs_no_memory(suffix, name, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    write_mesh(bumpy(), path)
    text, n_changed = re.subn(rf'{name}="\d+"', f'{name}="99999999999"', path.read_text())
    assert n_changed == 1
    path.write_text(text)
    with pytest.raises(OSError, match=r"99,999,999,999 values are announced in"):
        read_mesh(path)


def read_or_refuse(path):
    """Return True for a mesh, False for an error in one line; let everything else through."""
    try:
        return isinstance(read_mesh(path), TriangleMesh)
    except (OSError, ValueError, ImportError, MemoryError) as error:
        message = str(error)
    assert len(message.splitlines()) == 1
    assert path.name in message
    return False


fuzz = settings(
    deadline=None,
    derandomize=True,
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def damaged(draw, content):
    """``content`` with up to six bytes changed, and cut short or not."""
    damaged = bytearray(content)
    for _ in range(draw(st.integers(0, 6))):
        damaged[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
    return bytes(damaged[: draw(st.just(len(content)) | st.integers(0, len(content)))])


@pytest.fixture(scope="module")
def good_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    for suffix in READABLE:
        write_mesh(bumpy(3, 4, crs="EPSG:32616"), folder / f"mesh{suffix}")
    return {path.suffix: path.read_bytes() for path in folder.iterdir()}


IN_PYTHON = sorted(set(READABLE) - {".vtu", ".vtp"})


@fuzz
@given(content=st.binary(max_size=300), suffix=st.sampled_from(IN_PYTHON))
def test_any_bytes_are_a_mesh_or_one_line(tmp_path, content, suffix):
    (tmp_path / f"mesh{suffix}").write_bytes(content)
    read_or_refuse(tmp_path / f"mesh{suffix}")


@fuzz
@given(data=st.data(), suffix=st.sampled_from(IN_PYTHON))
def test_a_damaged_file_is_a_mesh_or_one_line(tmp_path, good_files, data, suffix):
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(damaged(data.draw, good_files[suffix]))
    tracemalloc.start()
    try:
        read_or_refuse(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


READ_ALL = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_write_mesh import read_or_refuse
for path in sorted(Path(sys.argv[2]).iterdir()):
    read_or_refuse(path)
print("done")
"""


def test_a_damaged_vtk_file_is_a_mesh_or_one_line(tmp_path, good_files):
    """VTK is C++, and where it fails it may end the process: it reads in one of its own."""

    @settings(deadline=None, derandomize=True, max_examples=100, database=None)
    @given(data=st.data(), suffix=st.sampled_from([".vtu", ".vtp"]))
    def write_one(data, suffix):
        any_bytes = st.binary(max_size=300)
        is_random = data.draw(st.integers(0, 9)) == 0
        content = data.draw(any_bytes) if is_random else damaged(data.draw, good_files[suffix])
        (tmp_path / f"{len(list(tmp_path.iterdir())):03}{suffix}").write_bytes(content)

    write_one()
    command = [sys.executable, "-c", READ_ALL, str(Path(__file__).parent), str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "done\n", "")


def test_without_pyvista_the_command_to_install_it_is_told(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    (tmp_path / "old.vtp").write_bytes(b"old")
    with pytest.raises(ImportError, match=re.escape('pip install "rtin[vtk]"')):
        write_mesh(bumpy(), tmp_path / "mesh.vtu")
    with pytest.raises(ImportError, match=re.escape('pip install "rtin[vtk]"')):
        read_mesh(tmp_path / "old.vtp")


# Whole or not at all


def test_a_missing_folder_is_told_in_one_line(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*; make it first"):
        write_mesh(bumpy(), tmp_path / "nowhere" / "mesh.ply")


def test_a_folder_in_the_place_of_the_file_is_told(tmp_path):
    (tmp_path / "mesh.ply").mkdir()
    with pytest.raises(IsADirectoryError, match="name a file in it"):
        write_mesh(bumpy(), tmp_path / "mesh.ply")


def test_a_folder_without_permission_is_told(tmp_path, monkeypatch):
    # Root may write anywhere, so the answer of the system is replaced.
    monkeypatch.setattr(os, "access", lambda folder, mode: Path(folder) != tmp_path)
    with pytest.raises(PermissionError, match=r"cannot write .*mesh\.ply: no permission"):
        write_mesh(bumpy(), tmp_path / "mesh.ply")


def test_what_is_wrong_with_a_path_is_told_before_the_work(tmp_path, monkeypatch):
    require_writable(tmp_path / "mesh.vtu")
    assert not list(tmp_path.iterdir())
    with pytest.raises(FileNotFoundError, match="make it first"):
        require_writable(tmp_path / "nowhere" / "mesh.glb")
    with pytest.raises(ValueError, match="extension"):
        require_writable(tmp_path / "mesh.tif")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match="pip install"):
        require_writable(tmp_path / "mesh.vtu")


def test_paths_of_meshes_are_told_from_those_of_rasters():
    assert is_mesh_path("a.glb")
    assert is_mesh_path("a.STL")
    assert not is_mesh_path("a.tif")
    assert not is_mesh_path("a.html")


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_a_failure_leaves_the_old_file_and_nothing_else(error, tmp_path):
    path = tmp_path / "mesh.ply"
    path.write_bytes(b"old")

    def write_half():
        with replacing(path) as part:
            part.write_bytes(b"half")
            raise error

    with pytest.raises((KeyboardInterrupt, OSError)):
        write_half()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_names_the_file_and_keeps_its_number(tmp_path):
    def fail():
        with replacing(tmp_path / "a.ply"):
            raise OSError(28, "No space left on device")

    with pytest.raises(
        OSError, match=r"^cannot write .*a\.ply: No space left on device$"
    ) as caught:
        fail()
    assert caught.value.errno == 28


def test_a_new_file_has_the_permissions_of_any_new_file(tmp_path):
    write_bytes(tmp_path / "ours", b"")
    (tmp_path / "any").touch()
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ours", "any")]
    assert modes[0] == modes[1]


def test_who_reads_the_old_file_reads_on_undisturbed(tmp_path):
    write_bytes(tmp_path / "mesh", b"old file")
    with (tmp_path / "mesh").open("rb", buffering=0) as reader:
        assert reader.read(4) == b"old "
        write_bytes(tmp_path / "mesh", b"new", b"er one")
        assert reader.read() == b"file"
    assert (tmp_path / "mesh").read_bytes() == b"newer one"


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real.ply").write_bytes(b"old")
    (tmp_path / "link.ply").symlink_to(tmp_path / "real.ply")
    write_mesh(bumpy(), tmp_path / "link.ply")
    assert (tmp_path / "link.ply").is_symlink()
    assert read_mesh(tmp_path / "real.ply").n_triangles == bumpy().n_triangles


FULL_DISK = """
import resource, sys
import numpy as np
sys.path.insert(0, sys.argv[2])
from hand_meshes import bumpy
from rtin.io.meshes import write_mesh
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
try:
    write_mesh(bumpy(60, 60), sys.argv[1])
except OSError as error:
    print(error)
"""


@pytest.mark.parametrize("suffix", WRITABLE)
def test_a_full_disk_leaves_the_old_file(suffix, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(b"old")
    result = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path), str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout == f"cannot write {path}: File too large\n"
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


SLOW = """
import signal, sys, time
from rtin._atomic import replacing
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored under nohup, for one
with replacing(sys.argv[1]) as part, part.open("wb") as file:
    file.write(b"half")
    file.flush()
    print("ready", flush=True)
    time.sleep(60)
"""


def test_an_interrupt_leaves_the_old_file(tmp_path):
    path = tmp_path / "mesh.ply"
    path.write_bytes(b"old")
    command = [sys.executable, "-c", SLOW, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"ready\n"
        assert len(list(tmp_path.iterdir())) == 2
        process.send_signal(signal.SIGINT)
        assert process.wait(10) != 0
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


# The page


def test_the_page_asks_nothing_of_the_network(tmp_path):
    write_mesh(in_degrees(), tmp_path / "mesh.html")
    page = (tmp_path / "mesh.html").read_text()
    tags = re.findall(r"<(?:script|link|img|iframe|source)\b[^>]*>", page)
    assert tags
    assert not [tag for tag in tags if re.search(r"\b(src|href)\b", tag)]
    assert "import(" not in page
    assert "@import" not in page


def test_the_page_has_a_title_and_the_whole_mesh(tmp_path):
    import base64

    write_mesh(bumpy(), tmp_path / "mesh.html")
    page = (tmp_path / "mesh.html").read_text()
    assert "<title>rtin: 96 triangles, 63 vertices</title>" in page
    assert page.count("W for the triangles") == 1
    assert page.count('addEventListener("keydown",function(e){if(e.key.toLowerCase()') == 1
    (tmp_path / "inside.glb").write_bytes(
        base64.b64decode(re.search(r'base64_data="([^"]+)"', page)[1])
    )
    tree = glb_json(tmp_path / "inside.glb")
    assert tree["cameras"][0]["type"] == "perspective"
    assert "KHR_materials_unlit" in tree["materials"][0]["extensions"]
    assert read_mesh(tmp_path / "inside.glb").n_triangles == 96


def test_writing_imports_nothing_heavy_before_it_is_asked():
    code = "import sys, rtin.io.meshes; print([m for m in sys.modules if m in sys.argv])"
    heavy = ["trimesh", "pyvista", "matplotlib", "scipy", "pyproj", "numba", "rasterio"]
    result = subprocess.run(
        [sys.executable, "-c", code, *heavy], capture_output=True, text=True, check=True
    )
    assert result.stdout == "[]\n"


WRITE_ALL = """
import sys
sys.path.insert(0, sys.argv[2])
from hand_meshes import bumpy
from rtin.io.meshes import write_mesh
for suffix in ("glb", "html", "obj", "ply", "stl"):
    write_mesh(bumpy(), f"{sys.argv[1]}/mesh.{suffix}")
print([m for m in sys.modules if m in ("trimesh", "pyvista", "matplotlib", "scipy")])
"""


def test_writing_imports_nothing_heavy_but_for_vtk(tmp_path):
    command = [sys.executable, "-c", WRITE_ALL, str(tmp_path), str(Path(__file__).parent)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout == "[]\n"


@pytest.mark.parametrize("suffix", [".vtu", ".vtp"])
def test_vtk_files_hold_the_elevation_to_colour_by(tmp_path, suffix):
    mesh = bumpy()
    write_mesh(mesh, tmp_path / f"mesh{suffix}", z_scale=2.0)
    data = pyvista.read(tmp_path / f"mesh{suffix}")
    assert np.array_equal(data.point_data["elevation"], 2.0 * mesh.vertices[:, 2])
