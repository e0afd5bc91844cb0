"""The control: a renderer that no longer draws as at its start gives no frame to a set, whatever became of it."""

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from made_sets import SIZE, make_plan, make_set
from numpy_renderer import NumpyRenderer

from symsol_annot.errors import RendererCrashedError, RenderError
from symsol_annot.generation.events import ShardBegunAgain
from symsol_annot.generation.executors import ThreadedExecutor
from symsol_annot.generation.generate import generate
from symsol_annot.generation.maker import ShardMaker
from symsol_annot.rendering import control
from symsol_annot.rendering.control import ControlledRenderer
from symsol_annot.rotations.so3 import uniform_rotations

CONTROL_FRAMES = 1 + 4  # a view, and counts
IMAGES = 20  # in two shards
PLAN = make_plan(test=IMAGES)
SHARD, *_ = PLAN.manifest().shards


def flipped(array):
    """A copy with one bit of one byte other than it was."""
    changed = array.copy()
    changed.reshape(-1)[changed.size // 2] ^= 1
    return changed


KINDS_OF_DAMAGE = {
    "picture": lambda view: replace(view, rgb=flipped(view.rgb)),
    "segmentation": lambda view: replace(view, segmentation=flipped(view.segmentation)),
    "area": lambda view: replace(view, part_pixels=view.part_pixels + 0.25),
    "size": lambda view: replace(view, rgb=view.rgb[:, :-1], segmentation=view.segmentation[:, :-1]),
    "type": lambda view: replace(view, segmentation=view.segmentation.astype(np.int8)),
}


class Damaged(NumpyRenderer):
    """Draws otherwise from one of its views on; with kind "count" it counts otherwise instead."""

    def __init__(self, kind, good_frames):
        super().__init__("tetX", SIZE)
        self.kind, self.good_frames, self.drawn = kind, good_frames, 0

    @property
    def is_damaged(self):
        return self.drawn > self.good_frames

    def render(self, R_m2c):
        self.drawn += 1
        view = super().render(R_m2c)
        return KINDS_OF_DAMAGE[self.kind](view) if self.is_damaged and self.kind in KINDS_OF_DAMAGE else view

    def marking_pixels(self, R_m2c):
        self.drawn += len(R_m2c)
        counts = super().marking_pixels(R_m2c)
        return counts + 0.25 if self.is_damaged and self.kind == "count" else counts


def controlled(good_frames=10**9, kind="picture"):
    return ControlledRenderer(Damaged(kind, good_frames))


def maker(renderer, **arguments):
    return ShardMaker(PLAN, renderer, check=renderer.check, **arguments)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_a_control_shows_the_marking_in_its_picture_and_hides_it_in_another_view(name):
    renderer = NumpyRenderer(name, 64)
    shown, *others = renderer.marking_pixels(control.control_rotations())
    assert shown == renderer.render(control.control_rotations()[0]).marking_pixels > 0
    assert min(others) == 0


@pytest.mark.parametrize("kind", [*KINDS_OF_DAMAGE, "count"])
def test_a_renderer_that_draws_otherwise_than_at_its_start_fails_its_check(kind):
    renderer = controlled(CONTROL_FRAMES + 3, kind)
    for R in uniform_rotations(3, np.random.default_rng(1)):
        renderer.render(R)
    with pytest.raises(RendererCrashedError, match=r"process \d+ drew a frame otherwise than at its start.*damaged"):
        renderer.check()


def test_a_renderer_that_draws_as_at_its_start_passes_every_check():
    renderer = controlled()
    for number, R in enumerate(uniform_rotations(5, np.random.default_rng(1)), start=1):
        renderer.render(R)
        renderer.marking_pixels(R[None])
        renderer.check()
        assert renderer.frames == 2 * number + (number + 1) * CONTROL_FRAMES


@pytest.mark.parametrize("draw", ["render", "marking_pixels"])
def test_no_more_than_a_bounded_number_of_frames_is_drawn_between_two_controls(monkeypatch, draw):
    monkeypatch.setattr(control, "FRAMES_PER_CONTROL", 20)
    monkeypatch.setattr(control, "_COUNTS_PER_SIGN", 1)
    renderer, drawn = controlled(CONTROL_FRAMES + 5), []
    R = np.eye(3) if draw == "render" else np.eye(3)[None]

    def draw_for_long():
        for number in range(100):
            getattr(renderer, draw)(R)
            drawn.append(number)

    with pytest.raises(RendererCrashedError, match="its memory is damaged"):
        draw_for_long()
    assert len(drawn) == 20


def test_controls_are_counted_as_frames_and_each_batch_of_counts_gives_a_sign_of_life():
    renderer, signs = controlled(), []
    assert renderer.frames == CONTROL_FRAMES
    renderer.on_batch = lambda: signs.append(renderer.frames)
    renderer.marking_pixels(uniform_rotations(200, np.random.default_rng(1)))
    assert signs == [CONTROL_FRAMES + count for count in (90, 180, 200)]
    renderer.render(np.eye(3))
    renderer.check()
    assert renderer.frames == CONTROL_FRAMES + 201 + CONTROL_FRAMES


@pytest.mark.parametrize("exhaustive", [False, True])
def test_a_shard_has_the_same_bytes_with_and_without_controls(exhaustive, monkeypatch):
    monkeypatch.setattr(control, "FRAMES_PER_CONTROL", 5)
    without = ShardMaker(PLAN, NumpyRenderer("tetX", SIZE), exhaustive=exhaustive).make(SHARD, lambda _: None)
    renderer = ControlledRenderer(NumpyRenderer("tetX", SIZE))
    made = maker(renderer, exhaustive=exhaustive).make(SHARD, lambda _: None)
    assert made.data == without.data
    assert renderer.frames > SHARD.images + 4 * CONTROL_FRAMES


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return contents(make_set(tmp_path_factory.mktemp("whole"), test=IMAGES))


def frames_of_a_shard():
    renderer = controlled()
    before = renderer.frames
    maker(renderer).make(SHARD, lambda _: None)
    return renderer.frames - before - CONTROL_FRAMES


@pytest.mark.parametrize("kind", ["picture", "segmentation", "count"])
@pytest.mark.parametrize("when", ["first frame", "middle", "last frame", "after the last frame"])
def test_no_frame_of_a_damaged_renderer_gets_into_a_set(tmp_path, whole, kind, when):
    """The first renderer is damaged in its first or second shard; whoever comes next makes that shard again."""
    frames = frames_of_a_shard()
    at = {"first frame": 0, "middle": frames // 2, "last frame": frames - 1, "after the last frame": frames}[when]
    opened, events = itertools.count(), []

    def open_maker():
        return maker(controlled(CONTROL_FRAMES + at, kind) if next(opened) == 0 else controlled())

    generate(PLAN, tmp_path / "tetX", lambda _: ThreadedExecutor(open_maker, 1), events.append)
    assert contents(tmp_path / "tetX") == whole
    (again,) = [event for event in events if isinstance(event, ShardBegunAgain)]
    assert "its memory is damaged" in again.reason
    assert next(opened) == 2


def test_a_damaged_renderer_whose_frames_are_refused_is_a_crash_and_not_an_error_that_ends_the_run():
    """A frame with a colour of nobody's is refused where it is read, and would end the run as any fault of a scene."""

    class Refused(Damaged):
        def render(self, R_m2c):
            view = super().render(R_m2c)
            if self.is_damaged and not self.is_control(R_m2c):
                raise RenderError("a frame came back empty")
            return view

        def is_control(self, R_m2c):
            return np.array_equal(R_m2c, self.first)

        first = None

    def opened(kind, good_frames):
        inner = Refused(kind, good_frames)
        inner.first = control.control_rotations()[0]
        return ControlledRenderer(inner)

    with pytest.raises(RendererCrashedError, match="its memory is damaged"):
        maker(opened("picture", CONTROL_FRAMES + 3)).make(SHARD, lambda _: None)
    with pytest.raises(RenderError, match="came back empty") as caught:
        maker(opened("none", CONTROL_FRAMES + 3)).make(SHARD, lambda _: None)
    assert not isinstance(caught.value, RendererCrashedError)


def test_a_set_whose_renderers_are_all_damaged_is_given_up_and_keeps_no_frame_of_theirs(tmp_path):
    opener = partial(controlled, CONTROL_FRAMES + 3)
    with pytest.raises(RendererCrashedError, match=r"3 workers were lost.*\n?.*its memory is damaged"):
        generate(PLAN, tmp_path / "tetX", lambda _: ThreadedExecutor(lambda: maker(opener()), 1))
    assert not (tmp_path / "tetX").exists()
