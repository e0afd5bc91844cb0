"""Mesh files as programs export them become objects: their group, their parts, their place."""

import json
import re

import numpy as np
import pytest
from exported_meshes import (
    COLOURS,
    cuboid,
    cup_of,
    handle_of,
    mesh_bytes,
    moved,
    mug,
    obj_lines,
    png_of,
    side_of,
    split_corners,
    textured_box,
)
from made_solids import SOLIDS, box, joined, lathe, prism

from symsol_annot.errors import ObjectError, OutputError
from symsol_annot.objects.importing.importing import ImportOptions, import_mesh
from symsol_annot.objects.importing.object_writing import object_files, written_object

trimesh = pytest.importorskip("trimesh")


@pytest.fixture
def imported(tmp_path):
    """Write a mesh file, import it, and return the object as it is read again, and what was said."""

    def run(data, name="part.stl", **options):
        path = tmp_path / name
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        made = import_mesh(path, "part", ImportOptions(**options))
        with written_object(tmp_path / "made", object_files(made.draft)) as (_, spec):
            return spec, made

    return run


def names(spec):
    return [part.name for part in spec.parts]


@pytest.mark.parametrize("ending", ["obj", "stl", "ascii", "ply", "off", "glb"])
@pytest.mark.parametrize("name", ["nut", "pyramid 5"])
def test_a_solid_in_any_format_unit_and_place_has_its_group_about_the_origin(imported, name, ending):
    solid, group = SOLIDS[name]
    data = mesh_bytes(moved(solid), ending)
    spec, made = imported(data, f"part.{'stl' if ending == 'ascii' else ending}")
    assert made.found.shape.group.name == group
    assert len(spec.symmetry_group) == len(spec.stabiliser) == made.found.shape.group.size
    assert np.linalg.norm(spec.mesh.vertices, axis=1).max() == pytest.approx(1, abs=1e-9)
    assert len(spec.mesh.vertices) == len(np.unique(solid[0][solid[1]].reshape(-1, 3), axis=0))


def test_where_the_object_lies_in_the_file_is_written_down(imported):
    solid = moved(SOLIDS["pyramid 5"][0])
    spec, made = imported(mesh_bytes(solid, "ply"), "part.ply")
    toml = made.draft.provenance
    axes = np.reshape(toml["axes_in_file"], (3, 3))
    back = spec.mesh.vertices @ axes * toml["file_units_per_unit"] + toml["origin_in_file"]
    nearest = np.linalg.norm(back[:, None] - solid[0], axis=-1).min(axis=1)
    assert nearest.max() < 1e-4  # of 56 mm: the file has 32 bits
    assert re.fullmatch("[0-9a-f]{64}", toml["source_sha256"])
    assert toml["source"] == "part.ply"


def test_face_colours_are_parts_in_linear_light(imported):
    solid = cuboid()
    spec, _ = imported(mesh_bytes(moved(solid), "ply", face_colors=COLOURS[side_of(solid)]), "part.ply")
    assert len(spec.parts) == 6
    assert {part.colour for part in spec.parts} == {tuple(float(c) for c in colour / 255) for colour in COLOURS}
    assert np.bincount(spec.mesh.part_ids).tolist() == [0] + [2] * 6
    assert (len(spec.symmetry_group), len(spec.stabiliser)) == (4, 1)


@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_vertex_colours_are_parts_where_a_face_has_one(imported, ending):
    solid = cuboid()
    colours = np.repeat(COLOURS[side_of(solid)], 3, axis=0)
    spec, made = imported(mesh_bytes(split_corners(solid), ending, vertex_colors=colours), f"part.{ending}")
    assert made.draft.provenance["parts_by"] == "colour"
    assert set(names(spec)) == {"colour-" + "".join(f"{c:02x}" for c in colour) for colour in COLOURS}


@pytest.mark.parametrize("noise", [False, True])
def test_a_texture_in_which_each_face_has_one_colour_makes_parts(imported, noise):
    spec, made = imported(textured_box(noise=noise), "part.glb")
    assert made.draft.provenance["parts_by"] == "colour"
    assert np.bincount(spec.mesh.part_ids).tolist() == [0] + [2] * 6
    found = np.array([part.colour for part in spec.parts])
    off = np.abs(found[:, None] - COLOURS / 255.0).max(axis=-1).min(axis=1)
    assert off.max() <= (0.02 if noise else 0.0)


def test_an_obj_s_texture_is_read_beside_it(imported, tmp_path):
    solid = cuboid()
    side = side_of(solid)
    corners = np.array([[0.2, 0.2], [0.8, 0.2], [0.5, 0.8]])
    places = (side[:, None, None] * [1, 0] + corners) / [6, 1]
    (tmp_path / "six colours.png").write_bytes(png_of(COLOURS[None]))
    (tmp_path / "part.mtl").write_text("newmtl paint\nKd 1 1 1\nmap_Kd -s 1 1 1 six colours.png\n")
    spec, _ = imported("mtllib part.mtl\nusemtl paint\n" + obj_lines(solid, places=places), "part.obj")
    assert len(spec.parts) == 6


def test_materials_are_parts_with_their_names_and_colours_the_largest_first(imported, tmp_path):
    solid = cuboid()
    materials = np.array(["red paint", "wood", "wood", "wood", "wood", "wood"])[side_of(solid)]
    (tmp_path / "part.mtl").write_text("newmtl red paint\nKd 0.8 0.1 0\nnewmtl wood\nKd 0.3 0.2 0.1\n")
    spec, _ = imported("mtllib part.mtl\n" + obj_lines(solid, materials), "part.obj")
    assert [(part.name, part.colour) for part in spec.parts] == [
        ("wood", (0.3, 0.2, 0.1)),
        ("red-paint", (0.8, 0.1, 0)),
    ]


def test_the_body_is_what_the_user_says(imported):
    solid = cuboid()
    materials = np.array(["dot", "wood", "wood", "wood", "wood", "wood"])[side_of(solid)]
    spec, _ = imported(obj_lines(solid, materials), "part.obj", body="dot")
    assert names(spec) == ["dot", "wood"]


def test_materials_of_one_colour_get_colours_that_can_be_told_apart(imported, tmp_path):
    solid = cuboid()
    materials = np.array(["a", "b", "b", "b", "b", "b"])[side_of(solid)]
    (tmp_path / "part.mtl").write_text("newmtl a\nKd 0.8 0.8 0.8\nnewmtl b\nKd 0.8 0.8 0.8\n")
    spec, _ = imported("mtllib part.mtl\n" + obj_lines(solid, materials), "part.obj")
    assert spec.parts[0].colour != spec.parts[1].colour


def test_nodes_of_a_scene_are_parts_where_they_stand(imported):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(*cup_of(), process=False), node_name="cup")
    handle = trimesh.Trimesh(*handle_of(), process=False)
    shift = trimesh.transformations.translation_matrix([5.0, 0.0, 0.0])
    handle.apply_translation([-5.0, 0.0, 0.0])
    scene.add_geometry(handle, node_name="handle", transform=shift)
    spec, _ = imported(scene.export(file_type="glb"), "part.glb")
    assert names(spec) == ["cup", "handle"]
    assert (len(spec.symmetry_group), len(spec.stabiliser)) == (24, 1)


def test_a_mirrored_node_is_not_inside_out(imported):
    scene = trimesh.Scene()
    scene.add_geometry(
        trimesh.Trimesh(*SOLIDS["pyramid 5"][0], process=False), transform=np.diag([1.0, 1.0, -1.0, 1.0])
    )
    _, made = imported(scene.export(file_type="glb"), "part.glb")
    assert not [note for note in made.notes if "outwards" in note]


def test_a_mug_of_two_shells_without_names_gets_its_handle_as_a_part(imported):
    spec, made = imported(mesh_bytes(moved(mug()), "stl"))
    assert names(spec) == ["body", "component-2"]
    assert (len(spec.symmetry_group), len(spec.stabiliser)) == (24, 1)
    assert any("components were made parts" in note for note in made.notes)


@pytest.mark.parametrize(
    ("solid", "rotations", "kept"),
    [(mug(), 24, 1), (SOLIDS["screw of 64 facets with a socket"][0], 64, 2)],
    ids=["mug", "screw"],
)
def test_a_body_with_a_larger_group_without_some_faces_is_compared_as_a_whole(imported, solid, rotations, kept):
    spec, made = imported(mesh_bytes(moved(solid), "stl"), parts="none")
    assert not made.draft.of_body
    assert (len(spec.symmetry_group), len(spec.stabiliser)) == (rotations, kept)


def test_facets_are_round_within_what_the_user_says(imported):
    data = mesh_bytes(moved(lathe([(0, -1), (0.6, -1), (0, 1)], 32)), "stl")
    assert len(imported(data)[0].symmetry_group) == 32
    spec, made = imported(data, round_within=0.01)
    assert len(spec.symmetry_group) == 360
    assert made.found.roundness.deviation < spec.max_offset < 0.01


def test_components_that_look_alike_are_one_part(imported):
    bar, leg = box(2.0, 2.0, 0.3), box(0.2, 0.2, 1.0)
    legs = [(leg[0] + [x, y, -0.9], leg[1]) for x in (0.1, 1.7) for y in (0.1, 1.7)]
    spec, made = imported(mesh_bytes(joined(bar, *legs), "stl"), parts="component")
    assert np.bincount(spec.mesh.part_ids).tolist() == [0, 12, 48]
    assert len(spec.stabiliser) == 4
    assert any("3 parts that a symmetry carries onto others" in note for note in made.notes)


def test_parts_may_be_left_out(imported):
    solid = cuboid()
    data = mesh_bytes(solid, "ply", face_colors=COLOURS[side_of(solid)])
    spec, _ = imported(data, "part.ply", parts="none")
    assert len(spec.parts) == 1


def test_winding_and_doubles_are_mended_and_said(imported):
    vertices, triangles = prism(6)
    triangles = triangles.copy()
    triangles[::3] = triangles[::3, ::-1]
    faces = np.concatenate([triangles, triangles[2:3]])
    spec, made = imported(mesh_bytes((vertices, faces), "ply"), "part.ply")
    assert len(spec.symmetry_group) == 12
    assert "1 triangle there twice left out" in made.notes
    assert any("wound as their neighbours are" in note for note in made.notes)


def test_a_triangle_without_area_leaves_no_gap(imported):
    vertices, triangles = box(2.0, 1.0, 1.0)
    edge = triangles[0]
    middle = (vertices[edge[0]] + vertices[edge[1]]) / 2
    vertices = np.concatenate([vertices, [middle]])
    a, b, c = edge
    faces = np.concatenate([triangles[1:], [[a, 8, c], [8, b, c], [a, b, 8]]])  # the last is a line
    spec, made = imported(mesh_bytes((vertices, faces), "ply"), "part.ply")
    assert len(spec.mesh.triangles) == 14
    assert "1 triangle without area left out" in made.notes


def test_a_surface_that_looks_inwards_is_turned(imported):
    vertices, triangles = prism(6)
    _, made = imported(mesh_bytes((vertices, triangles[:, ::-1]), "stl"))
    assert "1 surface that looked inwards turned outwards" in made.notes


def test_what_no_camera_sees_is_left_out(imported):
    inner = 0.3 * prism(5)[0], prism(5)[1]
    spec, made = imported(mesh_bytes(joined(prism(6), inner), "stl"))
    assert len(spec.symmetry_group) == 12
    assert "1 surface inside others, which no camera sees, left out" in made.notes


def test_solids_that_touch_along_an_edge_are_cut_apart_there(imported):
    unit = box(1.0, 1.0, 1.0)
    spec, made = imported(mesh_bytes(joined(unit, (unit[0] + [1.0, 1.0, 0.0], unit[1])), "stl"))
    assert len(spec.mesh.triangles) == 24
    assert len(spec.mesh.vertices) == 16
    assert any("cut apart" in note for note in made.notes)


def test_vertices_off_by_rounding_are_evened_so_that_the_group_is_exact(imported):
    vertices, triangles = SOLIDS["nut"][0]
    spec, made = imported(mesh_bytes((np.round(vertices, 4), triangles), "ply"), "part.ply")
    assert len(spec.symmetry_group) == 12
    assert any("vertices were moved by up to" in note for note in made.notes)


def test_the_same_file_gives_the_same_bytes(tmp_path):
    solid = cuboid()
    data = mesh_bytes(moved(solid), "ply", face_colors=COLOURS[side_of(solid)])
    made = [object_files(import_mesh_of(tmp_path, data, "part.ply").draft) for _ in range(2)]
    assert made[0] == made[1]


def test_a_file_name_of_any_kind_is_a_title(imported):
    spec, _ = imported(mesh_bytes(prism(6), "stl"), 'odd "name" \\ \x1b \u00e9\U0001f600.stl')
    assert spec.title == 'made from odd "name" \\ ? \u00e9\U0001f600.stl'


def test_a_folder_is_replaced_only_where_this_program_made_all_of_it(imported, tmp_path):
    data = mesh_bytes(cuboid(), "stl")
    imported(data)
    imported(mesh_bytes(prism(3), "stl"))
    toml = tmp_path / "made" / "object.toml"
    toml.write_text(toml.read_text() + "# mine\n")
    with pytest.raises(OutputError, match="nothing was touched"):
        imported(data)
    assert toml.read_text().endswith("# mine\n")


def test_nothing_stays_of_an_object_that_is_refused(tmp_path):
    made = import_mesh_of(tmp_path, mesh_bytes(prism(6), "stl"))
    with pytest.raises(ObjectError), written_object(tmp_path / "made", object_files(made.draft)):
        raise ObjectError("refused at last")
    assert [path.name for path in tmp_path.iterdir()] == ["part.stl"]


def import_mesh_of(folder, data, name="part.stl"):
    (folder / name).write_bytes(data)
    return import_mesh(folder / name, "part", ImportOptions())


@pytest.mark.skipif("dae" in trimesh.available_formats(), reason="pycollada is installed")
def test_dae_without_pycollada_says_what_to_install(imported):
    with pytest.raises(ObjectError, match="pip install pycollada"):
        imported(b"<COLLADA/>", "part.dae")


def test_a_gltf_reads_its_buffer_beside_it_and_names_one_that_is_not_there(imported, tmp_path):
    files = trimesh.Scene(trimesh.Trimesh(*prism(6), process=False)).export(file_type="gltf")
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    text = files["model.gltf"]
    spec, _ = imported(text, "part.gltf")
    assert len(spec.symmetry_group) == 12
    document = json.loads(text)
    document["buffers"][0]["uri"] = "../secret.bin"
    with pytest.raises(ObjectError, match=r"the file '../secret.bin', which it names, is not beside it"):
        imported(json.dumps(document), "part.gltf")
