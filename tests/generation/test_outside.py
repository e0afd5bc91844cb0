"""An audit draws rotations that the object does not declare, so that a group which is too small shows."""

from functools import partial

import numpy as np
import pytest
from made_sets import threads
from mesh_renderer import MeshRenderer
from parted_objects import parted_toml, prism

from symsol_annot import load
from symsol_annot.generation.audit import audit
from symsol_annot.generation.generate import generate
from symsol_annot.generation.outside import NEAR_MEMBER_RAD, found_outside, near_members
from symsol_annot.objects.checking.check import Checked
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import angle_between
from symsol_annot.sets.plan import SetPlan

IMAGES = 3


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Make a set of a prism of eight sides as if it had the declared group; no check looks at that."""
    monkeypatch.setattr("symsol_annot.generation.generate.check_object", lambda spec: Checked(None, 0.0, ()))

    def make(group):
        folder = tmp_path / "prism"
        folder.mkdir()
        (folder / "object.toml").write_text(parted_toml([("body", "clay", None)], group))
        (folder / "mesh.obj").write_text(str(prism(radius=0.8, half=0.6)))
        plan = SetPlan(read_object(folder), {"test": IMAGES}, 0, Camera.filling(32), RenderSettings(), "test")
        generate(plan, tmp_path / "set", threads(partial(MeshRenderer, plan.spec, plan.camera)))
        return plan, load(tmp_path / "set", "test")

    return make


def audit_of(plan, images):
    outside, not_looked_for = found_outside(plan.spec)
    assert not_looked_for
    rng = np.random.default_rng(0)
    return outside, audit(images, plan, MeshRenderer(plan.spec, plan.camera), IMAGES, rng, outside=outside)


def test_a_set_of_half_the_group_has_faults(made):
    plan, images = made('kind = "cyclic"\norder = 8')
    outside, report = audit_of(plan, images)
    np.testing.assert_allclose(angle_between(outside, np.eye(3)), np.pi, atol=1e-6)  # the half turns of a prism
    assert report.outside == 8 * IMAGES
    assert len(report.faults) == 8 * IMAGES
    assert "draws the same image, and is a symmetry found from the mesh" in report.faults[0]


def test_a_set_of_the_whole_group_has_none_and_says_what_was_drawn(made):
    plan, images = made('kind = "dihedral"\norder = 8')
    outside, report = audit_of(plan, images)
    assert (len(outside), report.outside, report.faults) == (0, 0, [])
    assert 0 < report.near_members <= 4 * IMAGES
    assert report.near_members_alike == 0


def test_random_rotations_near_members_are_as_near_as_stated_and_no_nearer(made):
    _, images = made('kind = "dihedral"\norder = 8')
    symmetry_set = images[0].symmetry_set
    near = near_members(symmetry_set, 64, np.random.default_rng(0))
    nearest = angle_between(near[:, None], symmetry_set.members[None]).min(axis=1)
    low, high = NEAR_MEMBER_RAD
    assert len(near) == 64  # members are 45 degrees apart
    assert low - 1e-6 <= nearest.min() < nearest.max() <= high + 1e-6
