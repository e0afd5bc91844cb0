"""A folder of BOP's models: the model asked for, and symmetries that are those of its mesh, wherever it lies."""

import json

import numpy as np
import pytest
from exported_meshes import COLOURS, cuboid, mesh_bytes, moved, side_of
from made_solids import SOLIDS, lathe

from symsol_annot.errors import ObjectError
from symsol_annot.objects.importing.bop_models import bop_model, compare_with_bop
from symsol_annot.objects.importing.importing import ImportOptions, import_mesh
from symsol_annot.objects.importing.object_writing import object_files, written_object

pytest.importorskip("trimesh")

HALF_TURNS = [np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])]
BOX = moved(cuboid())
FIXED = (BOX[0].min(axis=0) + BOX[0].max(axis=0)) / 2  # its half turns leave the middle in place
CAN = lathe([(0, -1), (0.6, -1), (0.6, 1), (0, 1)], 64)
SPOT = np.array([3.0, 4.0, 5.0])


def about(R, point):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, point - R @ point
    return matrix.ravel().tolist()


def half_turns_of_the_box():
    from exported_meshes import TURN

    return [about(TURN @ R @ TURN.T, FIXED) for R in HALF_TURNS]


@pytest.fixture
def compared(tmp_path):
    """Write a folder of models, import one, and compare its symmetries with those that are stated."""

    def run(data, info, number=3, ignored=False):
        (tmp_path / "obj_000003.ply").write_bytes(data)
        (tmp_path / "models_info.json").write_text(json.dumps({"3": {"diameter": 1, **info}}))
        path, bop = bop_model(tmp_path, number)
        made = import_mesh(path, "part", ImportOptions())
        with written_object(tmp_path / "made", object_files(made.draft)) as (_, spec):
            if not ignored:
                compare_with_bop(bop, made.found, made.frame @ spec.stabiliser @ made.frame.T, path)
        return spec

    return run


def test_discrete_symmetries_with_translations_are_those_about_the_origin(compared):
    spec = compared(mesh_bytes(BOX, "ply"), {"symmetries_discrete": half_turns_of_the_box()})
    assert len(spec.symmetry_group) == 4


def test_a_circle_is_one_of_facets_with_its_offset_on_the_axis(compared):
    can = CAN[0] * 30 + SPOT, CAN[1]
    info = {
        "symmetries_continuous": [{"axis": [0, 0, 2], "offset": [3, 4, 99]}],
        "symmetries_discrete": [about(HALF_TURNS[0], SPOT)],
    }
    assert len(compared(mesh_bytes(can, "ply"), info).symmetry_group) == 128


def test_paint_breaks_symmetries_that_are_not_stated(compared):
    data = mesh_bytes(BOX, "ply", face_colors=COLOURS[side_of(cuboid())])
    assert len(compared(data, {}).stabiliser) == 1


@pytest.mark.parametrize(
    ("info", "what"),
    [
        ({}, "states no symmetry, and the mesh has D2: the mesh has 4 rotations that leave it in place"),
        (
            {"symmetries_discrete": [about(HALF_TURNS[0], FIXED)]},
            "states 1 discrete, and the mesh has D2: .* no rotation",
        ),
        ({"symmetries_discrete": half_turns_of_the_box()[:1]}, "4 rotations that leave it in place, and not all"),
        (
            {
                "symmetries_discrete": [
                    about(np.array(one).reshape(4, 4)[:3, :3], FIXED * 0) for one in half_turns_of_the_box()
                ]
            },
            "number 1 of symmetries_discrete moves the mesh's fixed point by",
        ),
        (
            {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": FIXED.tolist()}]},
            "states 1 continuous, .* the turns about axis 1 of symmetries_continuous are not in that group",
        ),
    ],
)
def test_a_contradiction_names_both_and_may_be_ignored(compared, info, what):
    with pytest.raises(ObjectError, match=what):
        compared(mesh_bytes(BOX, "ply"), info)
    assert len(compared(mesh_bytes(BOX, "ply"), info, ignored=True).symmetry_group) == 4


def test_an_axis_beside_the_mesh_s_is_refused(compared):
    with pytest.raises(ObjectError, match=r"axis 1 of symmetries_continuous passes the mesh's fixed point at 0\.\d+"):
        compared(mesh_bytes(CAN, "ply"), {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0.3, 0, 0]}]})


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("{", "is no JSON"),
        ("[]", "has no entry of the model 3"),
        ('{"3": {"symmetries_discrete": [[1, 2]]}}', "3.symmetries_discrete: expected lists of 16 numbers"),
        ('{"3": {"symmetries_discrete": [' + str([2.0] * 16) + "]}}", "an entry is no rotation"),
        ('{"3": {"symmetries_continuous": [{"axis": [0, 0, 0], "offset": [0, 0, 0]}]}}', "an axis has no direction"),
        ('{"3": {"symmetries_continuous": [{"axis": [0, 0, 1]}]}}', "offset: expected lists of 3 numbers"),
        ('{"3": {"symmetries_continuous": 5}}', "expected a list of tables with axis and offset"),
    ],
)
def test_a_broken_list_of_symmetries_is_named(tmp_path, text, what):
    (tmp_path / "obj_000003.ply").write_bytes(mesh_bytes(SOLIDS["nut"][0], "ply"))
    (tmp_path / "models_info.json").write_text(text)
    with pytest.raises(ObjectError, match=what):
        bop_model(tmp_path, 3)


def test_the_model_has_to_be_there_and_to_be_named_where_there_are_several(tmp_path):
    with pytest.raises(ObjectError, match=r"is a folder without obj_000001\.ply or its like"):
        bop_model(tmp_path, None)
    (tmp_path / "obj_000003.ply").write_bytes(b"")
    assert bop_model(tmp_path, None) == (tmp_path / "obj_000003.ply", None)
    (tmp_path / "obj_000012.ply").write_bytes(b"")
    with pytest.raises(ObjectError, match="has 2 models; say which with --id, one of 3, 12"):
        bop_model(tmp_path, None)
    with pytest.raises(ObjectError, match="has no model 4; there are 3, 12"):
        bop_model(tmp_path, 4)
