"""The formats of FEM and GIS programs; round trips of all formats are in test_write_mesh.py."""

import re
import sys
import tracemalloc

import h5py
import meshio
import numpy as np
import pytest
import pyvista
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hand_meshes import bumpy, in_degrees, in_utm
from rtin import validity
from rtin.io.meshes import read_mesh, write_mesh
from rtin.mesh import TriangleMesh
from test_write_mesh import damaged, read_or_refuse

WITH_TAGS = [".msh", ".xdmf", ".2dm", ".vtu", ".vtp"]
TEXT = [".msh", ".xdmf", ".2dm"]
TAGS = {
    "several": [5, 1, 2, 7],
    "one": [3],
    "zero and negative": [0, -1, 4],
    "the largest": [2**31 - 1, 1 - 2**31, -(2**31)],
}


def with_tags(mesh, tags):
    return TriangleMesh(mesh.vertices, mesh.triangles, mesh.crs, np.resize(tags, mesh.n_triangles))


def round_trip(mesh, path, **options):
    write_mesh(mesh, path, **options)
    return read_mesh(path)


# Round trips


@pytest.mark.parametrize("suffix", WITH_TAGS)
@pytest.mark.parametrize("tags", TAGS.values(), ids=TAGS)
def test_reading_gives_back_the_tags(tags, suffix, tmp_path):
    mesh = with_tags(in_utm(), tags)
    back = round_trip(mesh, tmp_path / f"mesh{suffix}")
    assert back.tags.dtype == np.int32
    for name in ("vertices", "triangles", "tags"):
        assert getattr(back, name).tobytes() == getattr(mesh, name).tobytes()
    assert back.crs == mesh.crs


@pytest.mark.parametrize("suffix", WITH_TAGS)
def test_a_mesh_without_tags_comes_back_without(suffix, tmp_path):
    assert round_trip(in_utm(), tmp_path / f"mesh{suffix}").tags is None


@pytest.mark.parametrize("suffix", WITH_TAGS)
def test_the_walls_of_a_solid_have_the_tag_0(suffix, tmp_path):
    mesh = with_tags(in_utm(), [5, 7])
    back = round_trip(mesh, tmp_path / f"mesh{suffix}", base=10.0)
    np.testing.assert_array_equal(back.tags[: mesh.n_triangles], mesh.tags)
    assert not back.tags[mesh.n_triangles :].any()


@pytest.mark.parametrize("suffix", TEXT)
def test_coordinates_of_the_world_are_in_the_file_as_they_are(suffix, tmp_path):
    mesh = in_utm()
    write_mesh(mesh, tmp_path / f"mesh{suffix}")
    text = (tmp_path / f"mesh{suffix}").read_text()
    x, y, z = mesh.vertices[-1].tolist()
    assert f"{x!r} {y!r} {z!r}\n" in text


@pytest.mark.parametrize("suffix", TEXT)
def test_degrees_are_scaled_to_metres_unless_kept(suffix, tmp_path):
    mesh = in_degrees()
    scaled = round_trip(mesh, tmp_path / f"scaled{suffix}")
    kept = round_trip(mesh, tmp_path / f"kept{suffix}", keep_degrees=True)
    np.testing.assert_allclose(scaled.vertices, mesh.vertices, rtol=0, atol=1e-12)
    assert kept.vertices.tobytes() == mesh.vertices.tobytes()


@pytest.mark.parametrize("suffix", [".msh", ".2dm"])
def test_a_file_that_another_program_changed_keeps_its_crs_but_not_our_order(suffix, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    mesh = in_utm()
    write_mesh(mesh, path)
    text = path.read_text()
    last = {".msh": r"\n96 2 2 1 1 .*\n", ".2dm": r"\nE3T 96 .*\n"}[suffix]
    text, n_changed = re.subn(last, "\n", text)
    assert n_changed == 1
    path.write_text(text.replace("$Elements\n96", "$Elements\n95"))
    back = read_mesh(path)
    assert (back.n_triangles, back.crs, back.tags) == (95, mesh.crs, None)


def test_a_crs_with_dashes_does_not_end_the_comment_of_an_xdmf(tmp_path):
    crs = 'LOCAL_CS["a -- b --- c-->",UNIT["metre",1.0]]'
    mesh = bumpy(crs=crs)
    assert round_trip(mesh, tmp_path / "mesh.xdmf").crs == mesh.crs


# What other programs find


@pytest.mark.parametrize("suffix", [".msh", ".xdmf", ".vtu"])
def test_meshio_finds_vertices_triangles_and_tags(suffix, tmp_path):
    mesh = with_tags(in_utm(), [5, 1, 2, 7])
    write_mesh(mesh, tmp_path / f"mesh{suffix}")
    found = meshio.read(tmp_path / f"mesh{suffix}")
    np.testing.assert_array_equal(found.points, mesh.vertices)
    (block,) = found.cells
    assert block.type == "triangle"
    np.testing.assert_array_equal(block.data, mesh.triangles)
    name = "gmsh:physical" if suffix == ".msh" else "tag"
    np.testing.assert_array_equal(found.cell_data[name][0], mesh.tags)


def test_vtk_finds_vertices_triangles_and_tags_in_an_xdmf(tmp_path):
    reader = pytest.importorskip("vtkmodules.vtkIOXdmf2").vtkXdmfReader()
    mesh = with_tags(in_utm(), [5, 1])
    write_mesh(mesh, tmp_path / "mesh.xdmf")
    reader.SetFileName(str(tmp_path / "mesh.xdmf"))
    reader.Update()
    found = pyvista.wrap(reader.GetOutputDataObject(0))
    np.testing.assert_array_equal(found.points, mesh.vertices)
    np.testing.assert_array_equal(found.cells_dict[5], mesh.triangles)
    np.testing.assert_array_equal(found.cell_data["tag"], mesh.tags)


def test_gmsh_makes_a_physical_group_of_each_tag(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    mesh = with_tags(in_utm(), [5, 1, 2, 7])
    write_mesh(mesh, tmp_path / "mesh.msh")
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(tmp_path / "mesh.msh"))
        numbers, places, _ = gmsh.model.mesh.getNodes()
        order = np.argsort(numbers)
        np.testing.assert_array_equal(np.reshape(places, (-1, 3))[order], mesh.vertices)
        for dimension, tag in gmsh.model.getPhysicalGroups():
            (surface,) = gmsh.model.getEntitiesForPhysicalGroup(dimension, tag)
            _, (nodes,) = gmsh.model.mesh.getElements(2, surface)[1:]
            found = np.reshape(nodes, (-1, 3)).astype(int) - 1
            np.testing.assert_array_equal(found, mesh.triangles[mesh.tags == tag])
    finally:
        gmsh.finalize()


@pytest.mark.parametrize("tags", TAGS.values(), ids=TAGS)
def test_each_tag_has_a_surface_of_its_own_with_a_positive_number(tags, tmp_path):
    # Gmsh drops triangles of other surfaces, and groups all triangles of one surface together.
    mesh = with_tags(in_utm(), tags)
    write_mesh(mesh, tmp_path / "mesh.msh")
    surfaces = meshio.read(tmp_path / "mesh.msh").cell_data["gmsh:geometrical"][0]
    assert surfaces.min() > 0
    pairs = np.unique(np.column_stack([mesh.tags, surfaces]), axis=0)
    assert len(pairs) == len(set(tags)) == len(set(surfaces))


def test_py2dm_finds_vertices_triangles_and_tags(tmp_path):
    py2dm = pytest.importorskip("py2dm")
    mesh = with_tags(in_utm(), [5, 1])
    write_mesh(mesh, tmp_path / "mesh.2dm")
    with py2dm.Reader(str(tmp_path / "mesh.2dm")) as reader:
        places = [node.pos for node in reader.iter_nodes()]
        cells = [(*element.nodes, element.materials[0]) for element in reader.iter_elements()]
    np.testing.assert_array_equal(places, mesh.vertices)
    np.testing.assert_array_equal(cells, np.column_stack([mesh.triangles + 1, mesh.tags]))


# Files of other programs

# A unit square of two triangles (group 7) beside a quad (group 9) and a border line; node numbers
# have gaps, and the nodes are not in their order.
MSH_4 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$Entities
0 1 2 0
3 0 0 0 1 0 0 1 4 0
1 1 0 0 2 1 0 2 9 11 0
2 0 0 0 1 1 0 1 -7 1 3
$EndEntities
$Nodes
3 6 10 41
1 3 0 2
10
20
0 0 0
1 0 0.5
2 1 0 2
41
40
2 1 2
2 0 2
2 2 0 2
11
12
0 1 5
1 1 0.25
$EndNodes
$Elements
3 4 1 4
1 3 1 1
1 10 20
2 2 2 2
2 10 20 12
3 12 11 10
2 1 3 1
4 20 40 41 12
$EndElements
"""
PLACES = [[0, 0, 0], [1, 0, 0.5], [2, 1, 2], [2, 0, 2], [0, 1, 5], [1, 1, 0.25]]
CORNERS = [[0, 1, 5], [5, 4, 0], [1, 3, 2], [1, 2, 5]]
SQUARES = TriangleMesh.from_triangles(PLACES, CORNERS, tags=[7, 7, 9, 9])

MSH_2 = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
2 7 "meadow"
$EndPhysicalNames
$Nodes
6
10 0 0 0
20 1 0 0.5
41 2 1 2
40 2 0 2
11 0 1 5
12 1 1 0.25
$EndNodes
$Elements
4
1 1 2 4 3 10 20
2 2 2 7 1 10 20 12
3 2 4 7 1 1 8 12 11 10
4 3 2 9 2 20 40 41 12
$EndElements
"""

SMS = """MESH2D
MESHNAME "squares"
NUM_MATERIALS_PER_ELEM 1
# a comment
E2L 9 10 20 3
E3T 1 10 20 12 7
E3T 2 12 11 10 7 # another
E4Q 3   20 40 41 12 9
ND 10 0 0 0
ND 20 1.0 0 5e-1
ND 41 2 1 2
ND 40 2 0 2
ND 11 0 1 5
ND 12 1 1 2.5000e-001
NS 10 20 -40
BEGPARAMDEF
GM "Mesh"
ENDPARAMDEF
"""


def assert_squares(mesh, tags=SQUARES.tags):
    np.testing.assert_array_equal(mesh.vertices, SQUARES.vertices)
    np.testing.assert_array_equal(mesh.triangles, SQUARES.triangles)
    np.testing.assert_array_equal(mesh.tags, tags)
    validity.check(mesh)


@pytest.mark.parametrize(
    ("name", "text"), [("four.msh", MSH_4), ("two.msh", MSH_2), ("squares.2dm", SMS)]
)
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_a_foreign_text_is_read(name, text, ends, tmp_path):
    (tmp_path / name).write_text(text, newline=ends)
    assert_squares(read_mesh(tmp_path / name))


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("binary", [False, True])
def test_what_meshio_writes_for_gmsh_is_read(version, binary, tmp_path, capfd):
    (tmp_path / "hand.msh").write_text(MSH_4.replace("-7", "7"))
    foreign = meshio.gmsh.read(tmp_path / "hand.msh")
    meshio.gmsh.write(tmp_path / "foreign.msh", foreign, version, binary)
    capfd.readouterr()
    assert_squares(read_mesh(tmp_path / "foreign.msh"))
    assert capfd.readouterr() == ("", "")


def big_endian(mesh):
    """A binary MSH 4.1 of one triangle of surface 3, its most significant bytes first."""
    header = b"$MeshFormat\n4.1 1 8\n" + (1).to_bytes(4, "big") + b"\n$EndMeshFormat\n"
    nodes = [np.array([1, 3, 1, 3], ">u8"), np.array([2, 3, 1], ">i4"), np.array([3], ">u8")]
    # Two coordinates on the surface follow each place.
    nodes += [np.array([1, 2, 3], ">u8"), np.pad(mesh.vertices, ((0, 0), (0, 2))).astype(">f8")]
    cells = [np.array([1, 1, 1, 1], ">u8"), np.array([2, 3, 2], ">i4"), np.array([1], ">u8")]
    cells += [np.array([1, *(mesh.triangles[0] + 1)], ">u8")]
    parts = [header, b"$Nodes\n", *map(bytes, nodes), b"\n$EndNodes\n"]
    return b"".join([*parts, b"$Elements\n", *map(bytes, cells), b"\n$EndElements\n"])


def test_a_big_endian_msh_with_parametric_nodes_is_read(tmp_path):
    mesh = TriangleMesh([[0, 0, 1], [2, 0, 2], [1, 1, 3]], [[0, 1, 2]])
    (tmp_path / "mesh.msh").write_bytes(big_endian(mesh))
    back = read_mesh(tmp_path / "mesh.msh")
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    np.testing.assert_array_equal(back.triangles, mesh.triangles)
    assert back.tags.tolist() == [3]  # of the surface: there are no groups


def test_surfaces_without_a_group_have_the_tag_0_where_others_have_one(tmp_path):
    (tmp_path / "mesh.msh").write_text(MSH_4.replace("2 1 0 2 9 11 0", "2 1 0 0 0"))
    assert_squares(read_mesh(tmp_path / "mesh.msh"), [7, 7, 0, 0])


def test_a_msh_without_groups_has_the_numbers_of_its_surfaces(tmp_path):
    text = re.sub(r"\$Entities.*\$EndEntities\n", "", MSH_4, flags=re.S)
    (tmp_path / "mesh.msh").write_text(text)
    assert_squares(read_mesh(tmp_path / "mesh.msh"), [2, 2, 1, 1])


def test_what_gmsh_writes_is_read(tmp_path):
    """Second order, quads and triangles, one surface with a group and one without."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        rectangle = gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
        square = gmsh.model.occ.addRectangle(2, 0, 0, 1, 1)
        gmsh.model.occ.fragment([(2, rectangle)], [(2, square)])
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [square], 9)
        gmsh.model.mesh.setRecombine(2, rectangle)
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)
        n_nodes = len(gmsh.model.mesh.getNodes()[0])
        for binary in (0, 1):
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.write(str(tmp_path / f"{binary}.msh"))
    finally:
        gmsh.finalize()
    for binary in (0, 1):
        mesh = read_mesh(tmp_path / f"{binary}.msh")
        validity.check(mesh)
        areas = mesh.signed_areas()
        assert mesh.n_vertices == n_nodes
        assert areas[mesh.tags == 0].sum() == pytest.approx(2.0)
        assert areas[mesh.tags == 9].sum() == pytest.approx(1.0)


def foreign_cells(tags, name="cell_tags"):
    cells = [
        ("line", [[0, 1]]),
        ("triangle", [[0, 1, 5], [5, 4, 0]]),
        ("quad", [[1, 3, 2, 5]]),
    ]
    return meshio.Mesh(np.array(PLACES, float), cells, cell_data={name: tags})


@pytest.mark.parametrize("data_format", ["XML", "HDF"])
def test_what_meshio_writes_as_xdmf_is_read(data_format, tmp_path, capfd):
    foreign = foreign_cells([[1], [7, 7], [9]])
    meshio.xdmf.write(tmp_path / "mesh.xdmf", foreign, data_format=data_format)
    assert_squares(read_mesh(tmp_path / "mesh.xdmf"))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["tag", "gmsh:physical", "medit:ref", "MaterialIDs"])
@pytest.mark.parametrize("suffix", [".xdmf", ".vtu"])
@pytest.mark.parametrize("kind", [np.int64, np.float64])
def test_tags_are_found_under_their_usual_names(name, suffix, kind, tmp_path):
    foreign = foreign_cells([np.array(part, kind) for part in ([1], [7, 7], [9])], name)
    meshio.write(tmp_path / f"mesh{suffix}", foreign)
    assert sorted(read_mesh(tmp_path / f"mesh{suffix}").tags.tolist()) == [7, 7, 9, 9]


@pytest.mark.parametrize("suffix", [".xdmf", ".vtu"])
@pytest.mark.parametrize("tags", [[[1], [7.5, 7], [9]], [[1], [1e10, 7], [9]]])
def test_what_is_no_whole_number_is_no_tag(tags, suffix, tmp_path):
    meshio.write(tmp_path / f"mesh{suffix}", foreign_cells([np.array(part) for part in tags]))
    assert read_mesh(tmp_path / f"mesh{suffix}").tags is None


@pytest.mark.parametrize("last", [[4, 1, 3, 2, 5], [3, 1, 2, 5, 3, 1, 3, 2]])
def test_tags_of_a_vtp_with_lines_and_points_are_those_of_its_faces(last, tmp_path):
    lines, faces = [2, 0, 1], [3, 0, 1, 5, 3, 5, 4, 0, *last]
    data = pyvista.PolyData(np.array(PLACES, float), faces=faces, lines=lines, verts=[1, 2])
    data.cell_data["material"] = [1, 2, 7, 7, 9, 9][: data.n_cells]
    data.save(tmp_path / "mesh.vtp")
    assert sorted(read_mesh(tmp_path / "mesh.vtp").tags.tolist()) == [7, 7, 9, 9]


def test_points_of_two_numbers_lie_at_height_zero(tmp_path):
    foreign = meshio.Mesh(np.array(PLACES)[:, :2], [("triangle", CORNERS)])
    meshio.xdmf.write(tmp_path / "mesh.xdmf", foreign, data_format="XML")
    mesh = read_mesh(tmp_path / "mesh.xdmf")
    np.testing.assert_array_equal(mesh.vertices, np.array(PLACES) * [1, 1, 0])
    assert mesh.tags is None


def test_vertices_at_one_place_are_merged_and_tags_stay_with_their_triangles(tmp_path):
    places = np.array(PLACES, float)[np.ravel(CORNERS)]
    soup = meshio.Mesh(places, [("triangle", np.arange(12).reshape(4, 3))])
    soup.cell_data["tag"] = [[4, 3, 2, 1]]
    meshio.xdmf.write(tmp_path / "soup.xdmf", soup, data_format="XML")
    mesh = read_mesh(tmp_path / "soup.xdmf")
    assert (mesh.n_vertices, mesh.tags.tolist()) == (6, [4, 3, 2, 1])
    expected = SQUARES.vertices[SQUARES.triangles]
    np.testing.assert_array_equal(mesh.vertices[mesh.triangles], expected)


SECOND_ORDER = {
    "triangle6": ([[0, 0], [2, 0], [0, 2], [1, 0], [1, 1], [0, 1]], 4),
    "quad8": ([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 2], [0, 1]], 6),
    "quad9": ([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 2], [0, 1], [1, 1]], 8),
}


@pytest.mark.parametrize(("kind", "case"), SECOND_ORDER.items())
@pytest.mark.parametrize("suffix", [".msh", ".xdmf", ".vtu"])
def test_cells_of_second_order_are_cut_at_all_their_nodes(kind, case, suffix, tmp_path):
    places, n_triangles = case
    n_nodes = len(places)
    points = np.column_stack([places, np.arange(n_nodes) ** 2.0])
    foreign = meshio.Mesh(points, [(kind, [range(n_nodes)])], cell_data={"tag": [[4]]})
    if suffix == ".msh":
        foreign.cell_data = {"gmsh:physical": [[4]], "gmsh:geometrical": [[1]]}
        meshio.gmsh.write(tmp_path / "mesh.msh", foreign, "2.2", binary=False)
    else:
        meshio.write(tmp_path / f"mesh{suffix}", foreign)
    mesh = read_mesh(tmp_path / f"mesh{suffix}")
    validity.check(mesh)
    np.testing.assert_array_equal(mesh.vertices, points)
    assert mesh.signed_areas().sum() == (2.0 if kind == "triangle6" else 4.0)
    assert mesh.tags.tolist() == [4] * n_triangles


def test_cells_without_a_material_have_tag_0_beside_those_that_have_one(tmp_path):
    nodes = "ND 1 0 0 0\nND 2 1 0 0\nND 3 1 1 0\nND 4 0 1 0\n"
    (tmp_path / "mesh.2dm").write_text(f"MESH2D\nE3T 1 1 2 3\nE3T 2 1 3 4 5.0\n{nodes}")
    assert read_mesh(tmp_path / "mesh.2dm").tags.tolist() == [0, 5]
    (tmp_path / "mesh.2dm").write_text(f"MESH2D\nE3T 1 1 2 3\nE3T 2 1 3 4\n{nodes}")
    assert read_mesh(tmp_path / "mesh.2dm").tags is None


def test_cells_of_second_order_are_cut_in_a_2dm_too(tmp_path):
    walk = {"E6T": [0, 3, 1, 4, 2, 5], "E8Q": [0, 4, 1, 5, 2, 6, 3, 7]}
    for card, kind in [("E6T", "triangle6"), ("E8Q", "quad8")]:
        places, n_triangles = SECOND_ORDER[kind]
        numbers = " ".join(str(node + 1) for node in walk[card])
        nodes = "".join(f"ND {i} {x} {y} 1\n" for i, (x, y) in enumerate(places, start=1))
        (tmp_path / "mesh.2dm").write_text(f"MESH2D\n{card} 1 {numbers}\n{nodes}")
        mesh = read_mesh(tmp_path / "mesh.2dm")
        validity.check(mesh)
        assert (mesh.n_triangles, mesh.tags) == (n_triangles, None)


ALTERNATING = {
    "mesh.2dm": "MESH2D\nE4Q 1 1 2 4 3 1\nE3T 2 2 5 4 2\nE4Q 3 3 4 7 6 3\nE3T 4 4 5 7 4\n"
    "ND 1 0 0 0\nND 2 1 0 0\nND 3 0 1 0\nND 4 1 1 0\nND 5 2 1 0\nND 6 0 2 0\nND 7 1 2 0\n",
    "mesh.msh": "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n7\n1 0 0 0\n2 1 0 0\n3 0 1 0\n"
    "4 1 1 0\n5 2 1 0\n6 0 2 0\n7 1 2 0\n$EndNodes\n$Elements\n4\n1 3 2 1 1 1 2 4 3\n"
    "2 2 2 2 1 2 5 4\n3 3 2 3 1 3 4 7 6\n4 2 2 4 1 4 5 7\n$EndElements\n",
}


@pytest.mark.parametrize(("name", "text"), ALTERNATING.items(), ids=ALTERNATING)
def test_cells_of_several_kinds_keep_their_order(name, text, tmp_path):
    (tmp_path / name).write_text(text)
    mesh = read_mesh(tmp_path / name)
    validity.check(mesh)
    assert mesh.tags.tolist() == [1, 1, 2, 3, 3, 4]


@pytest.mark.parametrize("turn", range(4))
def test_a_quad_with_a_dent_is_cut_inside(turn, tmp_path):
    dented = np.roll([[0, 0, 0], [3, 0, 0], [1, 1, 0], [0, 3, 0]], turn, axis=0)
    nodes = "".join(f"ND {i} {x} {y} {z}\n" for i, (x, y, z) in enumerate(dented, start=1))
    (tmp_path / "mesh.2dm").write_text(f"MESH2D\nE4Q 1 1 2 3 4\n{nodes}")
    mesh = read_mesh(tmp_path / "mesh.2dm")
    validity.check(mesh)
    assert mesh.signed_areas().sum() == 3.0


# Errors


@pytest.mark.parametrize("suffix", [".msh", ".xdmf", ".vtu"])
def test_cells_with_a_volume_are_refused(suffix, tmp_path):
    cells = [("triangle", [[0, 1, 5]]), ("tetra", [[0, 1, 5, 4]])]
    zeros = [np.zeros(1, int), np.zeros(1, int)]
    data = {"gmsh:physical": zeros, "gmsh:geometrical": zeros}
    foreign = meshio.Mesh(np.array(PLACES, float), cells, cell_data=data)
    options = {".msh": {"file_format": "gmsh22"}, ".xdmf": {"data_format": "XML"}}
    meshio.write(tmp_path / f"mesh{suffix}", foreign, **options.get(suffix, {}))
    with pytest.raises(
        OSError, match=r"triangles and quads are wanted, got cells of kind [tT]etra"
    ):
        read_mesh(tmp_path / f"mesh{suffix}")


WRONG = [
    ("four.msh", MSH_4, "4.1 0 8", "4 0 8", r"MSH 2\.2 and 4\.1 are read, got 4; save it anew"),
    ("four.msh", MSH_4, "2 1 3 1", "2 2 4 1", "got cells of kind tetra"),
    ("four.msh", MSH_4, "2 1 3 1", "2 2 92 1", "got cells of Gmsh's type 92"),
    ("four.msh", MSH_4, "4 20 40", "4 20 39", "a cell names node 39, which is not there"),
    ("four.msh", MSH_4, "\n11\n", "\n12\n", "node 12 is there twice"),
    ("four.msh", MSH_4, "3 6 10", "9 6 10", "more numbers are announced than are there"),
    ("four.msh", MSH_4, "1 3 0 2", "1 3 0 999999999999", "999,999,999,999 more numbers"),
    ("four.msh", MSH_4, "0 0.5", "x 0.5", "something that is no number stands where"),
    ("four.msh", MSH_4, "$EndElements", "", r"\$EndElements is missing; the file is cut short"),
    ("two.msh", MSH_2, "$Elements\n4", "$Elements\n5", "more numbers are announced"),
    ("two.msh", MSH_2, "$Nodes\n6", "$Nodes\n-1", "a count must be zero or more, got -1"),
    ("two.msh", MSH_2, "4 3 2 9", "4 3 -2 9", "a cell must have zero tags or more, got -2"),
    ("a.2dm", SMS, "MESH2D", "MESH3D", "it does not start with MESH2D"),
    ("a.2dm", SMS, "20 40 41 12 9", "20 40 41", "line 8: E4Q wants a number and 4 nodes, got 4"),
    ("a.2dm", SMS, "ND 40 2 0 2", "ND 40 2 0", "line 12: ND wants a number, x, y and z, got 3"),
    ("a.2dm", SMS, "ND 40", "ND 4O", "something that is no number stands where"),
    ("a.2dm", SMS, "ND 40", "ND 20", "node 20 is there twice"),
    ("a.2dm", SMS, "20 40 41", "20 40 42", "a cell names node 42, which is not there"),
    ("a.2dm", SMS, "10 20 12 7", "10 20.5 12 7", "a number and 3 nodes, got a fraction"),
    ("a.2dm", SMS, "10 20 12 7", "10 20 12 7.5", "a material is a whole number .*, got '7.5'"),
    ("a.2dm", SMS, "10 20 12 7", "10 20 12 5000000000", "a material is a whole number of 32 bits"),
]


@pytest.mark.parametrize(("name", "text", "old", "new", "message"), WRONG)
def test_what_is_wrong_is_told_in_one_line(name, text, old, new, message, tmp_path):
    assert text.count(old) == 1
    (tmp_path / name).write_text(text.replace(old, new))
    with pytest.raises(OSError, match=message) as caught:
        read_mesh(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


@pytest.mark.parametrize(("suffix", "n_bytes"), [(".msh", 20), (".2dm", 1)])
def test_a_file_that_lacks_its_very_end_is_told(suffix, n_bytes, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    write_mesh(bumpy(), path)
    path.write_bytes(path.read_bytes()[:-n_bytes])
    with pytest.raises(OSError, match=r"the file is cut short$"):
        read_mesh(path)


def test_an_xdmf_without_its_hdf5_file_is_told(tmp_path):
    meshio.xdmf.write(tmp_path / "mesh.xdmf", foreign_cells([[1], [7, 7], [9]]))
    (tmp_path / "mesh.h5").unlink()
    with pytest.raises(OSError, match=r"the numbers are in mesh\.h5, which is not beside it"):
        read_mesh(tmp_path / "mesh.xdmf")


def test_an_hdf5_file_that_announces_what_it_does_not_hold_costs_no_memory(tmp_path):
    meshio.xdmf.write(tmp_path / "mesh.xdmf", foreign_cells([[1], [7, 7], [9]]))
    with h5py.File(tmp_path / "mesh.h5", "a") as file:
        del file["data0"]
        file.create_dataset("data0", shape=(10**9, 3), dtype="f8", chunks=(1000, 3))
    with pytest.raises(OSError, match="3,000,000,000 values are announced in"):
        read_mesh(tmp_path / "mesh.xdmf")


@pytest.mark.parametrize("missing", ["meshio", "h5py"])
def test_without_a_library_the_command_to_install_it_is_told(missing, tmp_path, monkeypatch):
    write_mesh(bumpy(), tmp_path / "mesh.xdmf")
    monkeypatch.setitem(sys.modules, missing, None)
    monkeypatch.delitem(sys.modules, f"{missing}.xdmf", raising=False)
    with pytest.raises(ImportError, match=re.escape('pip install "rtin[fem]"')):
        read_mesh(tmp_path / "mesh.xdmf")


@pytest.mark.parametrize("suffix", TEXT)
def test_writing_needs_no_library(suffix, tmp_path, monkeypatch):
    for name in ("meshio", "h5py", "skfem"):
        monkeypatch.setitem(sys.modules, name, None)
    write_mesh(bumpy(), tmp_path / f"mesh{suffix}")


@pytest.fixture(scope="module")
def foreign_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "four.msh").write_text(MSH_4)
    (folder / "two.msh").write_text(MSH_2)
    (folder / "squares.2dm").write_text(SMS)
    foreign = meshio.gmsh.read(folder / "four.msh")
    for version in ("2.2", "4.1"):
        meshio.gmsh.write(folder / f"binary {version}.msh", foreign, version, binary=True)
    mesh = TriangleMesh([[0, 0, 1], [2, 0, 2], [1, 1, 3]], [[0, 1, 2]])
    (folder / "big.msh").write_bytes(big_endian(mesh))
    foreign = foreign_cells([[1], [7, 7], [9]])
    meshio.xdmf.write(folder / "mesh.xdmf", foreign, data_format="XML")
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_foreign_file_is_a_mesh_or_one_line(tmp_path, foreign_files, data, capfd):
    name = data.draw(st.sampled_from(sorted(foreign_files)))
    (tmp_path / name).write_bytes(damaged(data.draw, foreign_files[name]))
    tracemalloc.start()
    try:
        read_or_refuse(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
    assert capfd.readouterr() == ("", "")
