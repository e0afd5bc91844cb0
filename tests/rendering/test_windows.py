"""Windows: they hold the points they are made for, and lie within the picture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from symsol_annot.rendering.windows import Window

WIDTH, HEIGHT = 40, 30
points = st.lists(st.tuples(st.floats(0, WIDTH), st.floats(0, HEIGHT)), min_size=1, max_size=6).map(np.array)
windows = st.builds(Window, st.integers(0, 20), st.integers(0, 20), st.integers(1, 20), st.integers(1, 20))


@given(points, st.sampled_from([1, 8]))
def test_a_window_holds_its_points_and_lies_in_the_picture(found, step):
    window = Window.around(found, WIDTH, HEIGHT, step)
    assert 0 <= window.left <= found[:, 0].min()
    assert 0 <= window.top <= found[:, 1].min()
    assert found[:, 0].max() <= window.left + window.width <= WIDTH
    assert found[:, 1].max() <= window.top + window.height <= HEIGHT
    assert window.width % step == 0 or window.width == WIDTH


@given(st.lists(points.filter(lambda found: len(found) >= 3), min_size=1, max_size=4))
def test_windows_of_several_hold_the_points_of_each_and_lie_in_the_picture(several):
    together = np.stack([found[:3] for found in several])
    for found, window in zip(together, Window.around_each(together, WIDTH, HEIGHT), strict=True):
        assert 0 <= window.left <= found[:, 0].min()
        assert 0 <= window.top <= found[:, 1].min()
        assert found[:, 0].max() <= window.left + window.width <= WIDTH
        assert found[:, 1].max() <= window.top + window.height <= HEIGHT
        assert window.area > 0


@given(windows, windows)
def test_what_two_windows_share_is_what_both_cut_out(one, other):
    picture = np.arange(50 * 50).reshape(50, 50)
    shared = one.within(other)
    expected = np.intersect1d(picture[one.slices], picture[other.slices])
    assert (shared is None) == (len(expected) == 0)
    if shared:
        assert np.array_equal(np.sort(picture[shared.slices], axis=None), expected)
        assert np.array_equal(picture[one.slices][shared.seen_from(one).slices], picture[shared.slices])


@pytest.mark.parametrize("n", [2, 4])
def test_the_lattice_of_a_window_has_a_point_on_each_of_its_edges(n):
    window = Window(3, 5, 7, 2).lattice(n)
    assert (window.left, window.top) == (3 * n, 5 * n)
    assert (window.width, window.height) == (7 * n + 1, 2 * n + 1)
    assert window.area == (7 * n + 1) * (2 * n + 1)
