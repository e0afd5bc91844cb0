"""Sets of rotations in the ball and on the map: each mark is where a formula by hand puts it."""

from dataclasses import replace

import numpy as np
import pytest
from balls import capped_set
from click.testing import CliRunner
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation
from symsol_annot_cli.plot import plot

from symsol_annot import load
from symsol_annot.annotation.volume import Volume
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_hypotheses
from symsol_annot.errors import RotationError
from symsol_annot.plotting.rotations import (
    directions_and_tilts,
    draw_mollweide,
    draw_pi_ball,
    plot_sets,
    rotations_at,
    shares_of_tilts,
    tilt_colours,
)
from symsol_annot.rotations.so3 import uniform_rotations

TO_MAP = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]])
Q = np.linalg.multi_dot([Rotation.from_euler(axis, 0.2).as_matrix() for axis in "zyx"])


def rotation_of(vector):
    """Rodrigues' formula, by hand."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle if angle else vector
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def ball_of(rotations, R_gt=None, predicted=None):
    """The collections of points in a pi-ball: for each its (k, 3) places."""
    figure = Figure()
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    draw_pi_ball(axes, rotations, R_gt, predicted)
    figure.canvas.draw()
    return axes, [np.stack(np.ma.getdata(points._offsets3d), axis=-1) for points in axes.collections]


def test_points_in_the_ball_are_the_rotation_vectors_of_the_set(tetX_set):
    for sample in load(tetX_set)[:6]:
        _, (points, own) = ball_of(sample.symmetry_set, sample.rotation)
        assert np.linalg.norm(points, axis=-1).max() <= np.pi + 1e-9
        assert len(points) == len(sample.symmetry_set)
        for point, R in zip(points, sample.symmetry_set, strict=True):
            assert np.allclose(rotation_of(point), R, atol=1e-9)
        assert np.allclose(rotation_of(own[0]), sample.rotation, atol=1e-9)
        assert len(own) == 1


def test_the_ball_is_drawn_to_radius_pi_with_equal_axes():
    half_turns = np.array([np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])])
    axes, (points,) = ball_of(
        np.concatenate([np.eye(3)[None], half_turns, uniform_rotations(80, np.random.default_rng(0))])
    )
    assert np.allclose(np.linalg.norm(points[:4], axis=-1), [0, np.pi, np.pi, np.pi])
    for low, high in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim()):
        assert (low, high) == (-np.pi, np.pi)
    outline = [np.stack(line.get_data_3d()) for line in axes.lines]
    assert np.allclose([np.linalg.norm(line, axis=0).max() for line in outline], np.pi)


def test_predictions_are_further_marks_in_the_ball():
    R = uniform_rotations(5, np.random.default_rng(0))
    _, marks = ball_of(R[:2], R[0], R[2:])
    assert [len(points) for points in marks] == [2, 1, 3]
    assert np.allclose([rotation_of(point) for point in marks[2]], R[2:], atol=1e-9)


def test_directions_and_tilts_make_the_rotation_again():
    R = uniform_rotations(200, np.random.default_rng(1))
    longitude, latitude, tilt = directions_and_tilts(R)
    angles = np.stack([longitude, -latitude, tilt], axis=-1)
    assert np.allclose(Rotation.from_euler("ZYX", angles).as_matrix(), TO_MAP @ R @ Q)


def test_an_axis_that_points_to_the_camera_is_in_the_middle_of_the_map():
    to_camera, to_the_right, up = ([0, 0, -1], [1, 0, 0], [0, -1, 0])  # in OpenCV's axes
    for direction, place in ((to_camera, (0, 0)), (to_the_right, (np.pi / 2, 0)), (up, (None, np.pi / 2))):
        other = np.cross(direction, [0.3, 0.5, 0.7])
        other /= np.linalg.norm(other)
        R = np.stack([direction, other, np.cross(direction, other)], axis=-1)
        longitude, latitude, _ = directions_and_tilts(R @ Q.T)
        assert np.isclose(latitude, place[1])
        assert place[0] is None or np.isclose(longitude, place[0])
    with pytest.raises(RotationError, match="expected rotations"):
        directions_and_tilts(np.zeros((3, 4)))


def test_colours_go_round_with_the_tilt_and_are_told_apart_without_red_and_green():
    """As a dichromat sees them: by lightness and by blue against yellow alone."""
    turn = np.linspace(0, 2 * np.pi, 25)
    colours = tilt_colours(turn)
    assert np.allclose(colours[0], colours[-1])
    assert ((colours >= 0) & (colours <= 1)).all()
    seen = np.stack([colours @ [0.2, 0.7, 0.1], colours[:, 2] - colours[:, :2].mean(axis=1)], axis=-1)[:-1]
    apart = np.linalg.norm(seen[:, None] - seen, axis=-1) + 9 * np.eye(24)
    assert apart.min() > 0.02


def test_marks_on_the_map_lie_where_the_axes_point(tetX_set):
    sample = next(sample for sample in load(tetX_set) if len(sample.symmetry_set) > 3)
    figure = Figure()
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="mollweide")
    predicted = uniform_rotations(4, np.random.default_rng(0))
    draw_mollweide(axes, sample.symmetry_set, sample.rotation, predicted)
    shown = [np.ma.getdata(marks.get_offsets()) for marks in axes.collections if len(marks.get_offsets())][:3]
    for places, R in zip(shown, (sample.symmetry_set, sample.rotation[None], predicted), strict=True):
        x = (TO_MAP @ R @ Q)[:, :, 0]
        on_sphere = [np.cos(places[:, 1]) * f(places[:, 0]) for f in (np.cos, np.sin)]
        assert np.allclose(np.stack([*on_sphere, np.sin(places[:, 1])], axis=-1), x, atol=1e-9)


def test_plot_sets_draws_the_predictions_of_a_file_over_the_truth(tetX_set, tmp_path):
    images = load(tetX_set)
    path = tmp_path / "preds.h5"
    write_hypotheses(path, images, images.labels().rotation[:, None], method="mine")
    write_classifier(path, images, lambda _, R: 0.9 * (R[:, 0, 0] > 0.9), method="mine", level=1, progress=False)
    sizes = {}
    for kind in ("pi-ball", "mollweide"):
        for track in ("hypotheses", "classifier", None):
            out = tmp_path / f"{kind}-{track}.svg"
            words = ["sets", str(tetX_set), "--image", "1", "--image", "5", "--kind", kind, "--out", str(out)]
            words += ["--predictions", str(path), "--track", track] if track else []
            done = CliRunner().invoke(plot, words)
            assert done.exit_code == 0, done.exception
            sizes[kind, track] = len(out.read_bytes())
        assert sizes[kind, "classifier"] > sizes[kind, "hypotheses"] > sizes[kind, None]  # more and more marks


@pytest.mark.parametrize("track", ["hypotheses", "classifier"])
def test_plot_sets_draws_over_each_image_what_the_file_says_of_that_image(tetX_set, tmp_path, monkeypatch, track):
    images, path, out = load(tetX_set), tmp_path / "preds.h5", tmp_path / "sets.png"
    R = uniform_rotations(3 * len(images), np.random.default_rng(2)).reshape(-1, 3, 3, 3)
    write_hypotheses(path, images, R, method="mine")
    own = images.labels().rotation @ images.symmetry_group[4]

    def claim(image, rotations):
        return 1.0 * (np.abs(rotations - own[image]).max(axis=(1, 2)) < 1e-6)

    write_classifier(path, images, claim, method="mine", level=0, progress=False)
    calls = []
    monkeypatch.setattr("symsol_annot_cli.plot.plot_sets", lambda *arguments: calls.append(arguments))
    words = ["sets", str(tetX_set), "--image", "7", "--image", "2", "--predictions", str(path), "--out", str(out)]
    done = CliRunner().invoke(plot, [*words, "--track", track, "--kind", "mollweide"])
    assert done.exit_code == 0, done.exception
    ((samples, *rest, predicted, title),) = calls
    assert [sample.index for sample in samples] == [7, 2]
    assert rest == [out, "mollweide"]
    assert title == "tetX, test: mine"
    wanted = R[[7, 2]] if track == "hypotheses" else own[[7, 2], None]
    assert [len(rotations) for rotations in predicted] == [wanted.shape[1]] * 2
    assert np.allclose(np.stack(predicted), wanted, atol=1e-6)


@pytest.mark.parametrize("method", ["$a_{$", "cost $5 and $6", "\u65e5\u672c\u8a9e"])
def test_plot_sets_takes_any_name_of_a_method(tetX_set, tmp_path, method):
    images = load(tetX_set)
    write_hypotheses(tmp_path / "preds.h5", images, images.labels().rotation[:, None], method=method)
    words = ["sets", str(tetX_set), "--predictions", str(tmp_path / "preds.h5"), "--out", str(tmp_path / "sets.svg")]
    with rc_context({"svg.fonttype": "none"}):  # text as text
        done = CliRunner().invoke(plot, words)
    assert done.exit_code == 0, done.exception
    assert f"tetX, test: {method}<" in (tmp_path / "sets.svg").read_text()


def test_plot_sets_refuses_what_is_not_there(tetX_set, tmp_path):
    images = load(tetX_set)
    write_hypotheses(tmp_path / "preds.h5", images, images.labels().rotation[:, None], method="mine")
    start = ["sets", str(tetX_set), "--out", str(tmp_path / "x.png")]
    given = ["--predictions", str(tmp_path / "preds.h5")]
    for words, said in (
        (["--image", "40"], "--image 40: the split has 40 images, from 0"),
        ([*given, "--track", "density"], "has hypotheses"),
        (["--track", "hypotheses"], "--track hypotheses: is of --predictions, which is not given"),
    ):
        done = CliRunner().invoke(plot, [*start, *words])
        assert done.exit_code == 2
        assert said in done.output
    assert not (tmp_path / "x.png").exists()


def test_a_picture_has_a_row_an_image(tetX_set, tmp_path):
    samples = load(tetX_set)[:3]
    for count in (1, 3):
        plot_sets(samples[:count], tmp_path / f"{count}.svg", "mollweide", title="a title")
    words = [(tmp_path / f"{count}.svg").read_text() for count in (1, 3)]
    assert [text.count("<image") for text in words] == [1, 3]


def test_rotations_at_directions_and_tilts_are_the_ones_that_have_them():
    R = uniform_rotations(50, np.random.default_rng(1))
    assert np.allclose(rotations_at(*directions_and_tilts(R)), R, atol=1e-12)


def test_a_volume_darkens_the_map_by_its_share_of_the_tilts():
    volume = Volume.of_cells(np.arange(0, 2359296, 3))  # a third, not the same along any ring
    rng = np.random.default_rng(2)
    latitude, longitude = np.arcsin(rng.uniform(-1, 1, 4000)), rng.uniform(-np.pi, np.pi, 4000)  # evenly
    shares = shares_of_tilts(volume, longitude, latitude)
    assert shares.mean() == pytest.approx(volume.measure, abs=0.01)
    tilts = rng.uniform(-np.pi, np.pi, 2000)
    by_drawing = [volume.contains(rotations_at(longitude[k], latitude[k], tilts)).mean() for k in range(20)]
    assert shares[:20] == pytest.approx(np.array(by_drawing), abs=0.25)
    assert shares.min() < shares.max()


@pytest.fixture(scope="module")
def ball_sample(tmp_path_factory):
    """An image of a ball whose only part is out of sight."""
    images = load(capped_set(tmp_path_factory.mktemp("balls")))
    return next(sample for sample in images if sample.symmetry_set.volume is not None)


def test_the_map_of_a_set_with_a_volume_says_what_its_grey_is(ball_sample, tmp_path):
    plot_sets([ball_sample], tmp_path / "with.svg", "mollweide")
    plot_sets([replace(ball_sample, volume=None)], tmp_path / "without.svg", "mollweide")
    with_volume, without = ((tmp_path / f"{name}.svg").read_text() for name in ("with", "without"))
    assert "grey: the share of the tilts" in with_volume
    assert "grey" not in without
