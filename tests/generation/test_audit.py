"""An audit finds nothing in a good set, and finds a set that the pictures contradict."""

import dataclasses

import numpy as np
import pytest
from made_sets import SIZE, make_plan, make_set
from numpy_renderer import NumpyRenderer

from symsol_annot import Sample, load
from symsol_annot.annotation.annotator import Annotator
from symsol_annot.errors import NotAnnotatedError, RendererCrashedError
from symsol_annot.generation.audit import audit
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rotations.so3 import uniform_rotations


class ChangedDataset:
    """A data set with each sample passed through a function."""

    def __init__(self, dataset, change):
        self.dataset, self.change = dataset, change

    def __getattr__(self, name):
        return getattr(self.dataset, name)

    def __len__(self):
        return len(self.dataset)

    def __getitem__(self, index):
        return self.change(self.dataset[index])


def audit_of(dataset, count=12):
    return audit(dataset, make_plan("tetX"), NumpyRenderer("tetX", SIZE), count, np.random.default_rng(0))


def test_depths_that_are_of_another_rotation_are_found(tmp_path):
    plan = make_plan("tetX", test=6, depth=True)
    renderer = NumpyRenderer("tetX", SIZE, has_depth=True)
    images = load(make_set(tmp_path, "tetX", test=6, depth=True))
    assert audit(images, plan, renderer, 6, np.random.default_rng(0)).faults == []
    farther = ChangedDataset(images, lambda s: dataclasses.replace(s, depth=np.where(s.depth > 0, s.depth + 0.1, 0)))
    faults = audit(farther, plan, renderer, 2, np.random.default_rng(0)).faults
    assert any("pixels of the depth differ" in fault for fault in faults)


def with_mask(sample, change):
    mask = sample.symmetry_mask.copy()
    change(mask)
    return dataclasses.replace(sample, symmetry_mask=mask)


def test_a_good_set_has_no_faults(tetX_set):
    report = audit_of(load(tetX_set))
    assert report.faults == []
    assert (report.images, report.members > 12, report.rejected > 12) == (12, True, True)


def test_a_transposed_label_is_found(tetX_set):
    changed = ChangedDataset(load(tetX_set), lambda s: dataclasses.replace(s, rotation=s.rotation.T))
    assert any("at its own rotation" in fault for fault in audit_of(changed).faults)


def test_a_set_that_lacks_a_member_is_found(tetX_set):
    spec = load_object("tetX")

    def drop_a_coset(mask):
        members = [coset for coset in spec.cosets[1:] if mask[coset].all()]
        if members:
            mask[members[0]] = False

    faults = audit_of(ChangedDataset(load(tetX_set), lambda s: with_mask(s, drop_a_coset))).faults
    assert any("rejected, but draws the same marking" in fault for fault in faults)


def test_a_set_with_a_foreign_rotation_is_found(tetX_set):
    def take_all(mask):
        mask[:] = True

    faults = audit_of(ChangedDataset(load(tetX_set), lambda s: with_mask(s, take_all))).faults
    assert any("member" in fault and ("shows the marking" in fault or "differ" in fault) for fault in faults)


def test_a_picture_of_something_else_is_found(tetX_set):
    other = load(tetX_set)[1]
    changed = ChangedDataset(load(tetX_set), lambda s: dataclasses.replace(s, image=other.image))
    assert any("pixels of the RGB differ" in fault for fault in audit_of(changed).faults)


def test_a_trace_of_the_marking_in_a_picture_that_hides_it_is_found_in_the_sets_own_colours(tetX_set):
    """The set's marking is said to be blue: a pixel that is bluer than the rest of its body is a trace of it."""
    plan = make_plan("tetX")
    blue = dataclasses.replace(plan.settings, body_colour=(0.9, 0.8, 0.2), marking_colour=(0.05, 0.1, 0.9))
    plan = dataclasses.replace(plan, settings=blue)

    class Recoloured(NumpyRenderer):
        def render(self, R_m2c):
            view = super().render(R_m2c)
            colours = np.array([[255, 255, 255], [240, 220, 100], [30, 60, 240]], dtype=np.uint8)
            rgb = colours[view.segmentation].copy()
            if self.leaks and view.marking_pixels == 0:
                rgb[SIZE // 2, SIZE // 2] = (165, 160, 180)
            return dataclasses.replace(view, rgb=rgb)

    def faults(*, leaks):
        renderer = Recoloured("tetX", SIZE)
        renderer.leaks = leaks
        own = ChangedDataset(load(tetX_set), lambda s: dataclasses.replace(s, image=renderer.render(s.rotation).rgb))
        return audit(own, plan, renderer, 12, np.random.default_rng(0)).faults

    assert faults(leaks=False) == []
    assert any("carries a trace of the marking's colour" in fault for fault in faults(leaks=True))


class Drifting(NumpyRenderer):
    """Draws a pixel otherwise from its 30th view on, by too little for any comparison of two views."""

    def __init__(self):
        super().__init__("tetX", SIZE)
        self.drawn = 0

    def render(self, R_m2c):
        view, self.drawn = super().render(R_m2c), self.drawn + 1
        if self.drawn > 30:
            view.rgb[0, 0, 0] -= 1
        return view


def test_a_renderer_that_drifts_while_it_audits_is_told(tetX_set):
    with pytest.raises(RendererCrashedError, match="drew a frame otherwise than at its start"):
        audit(load(tetX_set), make_plan("tetX"), Drifting(), 12, np.random.default_rng(0))


def test_a_split_without_sets_is_refused(tetX_set):
    with pytest.raises(NotAnnotatedError, match="no symmetry sets to audit"):
        audit_of(load(tetX_set, "train"))


def test_an_unmarked_body_is_audited_by_its_looks(tmp_path):
    dataset = load(make_set(tmp_path, "tet", test=4))
    report = audit(dataset, make_plan("tet"), NumpyRenderer("tet", SIZE), 4, np.random.default_rng(0))
    assert (report.faults, report.rejected) == ([], 0)
    assert report.members == 4 * 12


@pytest.mark.blender
def test_an_arc_that_ends_too_early_is_found():
    """Members a degree or more from a hidden disc's arc end are no near neighbours but missing."""
    plan = make_plan("cylO", size=64)
    spec = plan.spec
    with RenderProcess(spec, plan.camera, plan.settings) as renderer:
        R = next(R for R in uniform_rotations(9, np.random.default_rng(1)) if renderer.marking_pixels(R[None])[0] == 0)
        mask, view = Annotator(spec, renderer).annotate(R, 0.0).mask, renderer.render(R)
        eroded = mask & np.roll(mask, 8) & np.roll(mask, -8)
        eroded[0] = True
        samples = [
            Sample(0, view.rgb, view.segmentation, R, 0.0, False, m, spec.symmetry_group) for m in (mask, eroded)
        ]
        reports = [audit(ListedDataset([s]), plan, renderer, 1, np.random.default_rng(0)) for s in samples]
    assert reports[0].faults == []
    assert any("rejected, but draws the same marking" in fault for fault in reports[1].faults)


@pytest.mark.blender
def test_near_neighbours_of_a_barely_shown_disc_are_counted_not_failed():
    """Where a pixel or two of the disc show, a candidate a degree away may draw the same ones: no fault."""
    plan = make_plan("cylO", size=64)
    spec = plan.spec
    only_R_gt = np.arange(720) == 0
    with RenderProcess(spec, plan.camera, plan.settings) as renderer:
        R = uniform_rotations(300, np.random.default_rng(1))
        pixels = renderer.marking_pixels(R)
        barely = [i for i in np.argsort(pixels) if pixels[i] > 0][:4]
        views = [renderer.render(R[i]) for i in barely]
        samples = [
            Sample(n, view.rgb, view.segmentation, R[i], pixels[i], True, only_R_gt, spec.symmetry_group)
            for n, (i, view) in enumerate(zip(barely, views, strict=True))
        ]
        report = audit(ListedDataset(samples), plan, renderer, 4, np.random.default_rng(0))
    assert report.faults == []
    assert report.near_neighbours > 0


class ListedDataset(list):
    """Samples that were never in a shard."""

    is_annotated = True
