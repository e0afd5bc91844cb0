"""Answers kept beside a predictions file: whose they are, who writes, and what of the folder is ever removed."""

import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from bench_sets import SUPPORT, small_set
from methods import model

from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.errors import OutputError, PredictionsError, SettingsError
from symsol_annot.system.scratch import MARK_NAME

IMAGES, LEVEL = 12, 0
STOPS_AT = 5


@pytest.fixture(scope="module")
def tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


def write(track, path, dataset, answer, **options):
    options = {"method": "mine", **options}
    if track == "hypotheses":
        write_hypotheses(path, dataset, answer, **options)
    else:
        {"classifier": write_classifier, "density": write_density}[track](path, dataset, answer, level=LEVEL, **options)


def stop(track, path, dataset, degrees=90.0, **options):
    """Begin, and fail at the sixth image."""
    with pytest.raises(RuntimeError):
        write(track, path, dataset, model(degrees, STOPS_AT), **options)


def angles(path):
    with h5py.File(path) as file:
        R = file["hypotheses"][:, 0]
    return np.degrees(np.arctan2(R[:, 1, 0], R[:, 0, 0])).round().tolist()


def contents_of(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


every_track = pytest.mark.parametrize("track", ["hypotheses", "classifier", "density"])


# --- whose answers they are ---


@every_track
def test_answers_of_an_earlier_call_are_used_only_when_that_is_asked_for(tetX, tmp_path, track):
    path = tmp_path / "preds.h5"
    stop(track, path, tetX)
    before = contents_of(tmp_path)
    words = (
        r"holds 5 of 12 answers, begun 20\d\d-.* UTC.*pass resume=True to keep them if they are, or delete the folder"
    )
    with pytest.raises(PredictionsError, match=words):
        write(track, path, tetX, model(1.0))
    assert contents_of(tmp_path) == before
    write(track, path, tetX, model(90.0), resume=True)
    assert path.exists()


def test_a_mended_method_that_begins_anew_has_no_answer_of_the_old_one(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    stop("hypotheses", path, tetX, degrees=1.0)
    shutil.rmtree(tmp_path / "preds.h5.parts" / "hypotheses")  # as the message says
    write("hypotheses", path, tetX, model(90.0))
    assert angles(path) == [90.0] * IMAGES


@every_track
def test_a_line_says_what_is_kept(tetX, tmp_path, track, caplog):
    path = tmp_path / "preds.h5"
    with caplog.at_level(logging.WARNING):
        stop(track, path, tetX)
        assert caplog.messages == []
        write(track, path, tetX, model(90.0), resume=True)
    (line,) = caplog.messages
    words = r"{}: 5 of 12 answers are kept, begun 20\d\d-\d\d-\d\d .* UTC; the other 7 are asked for now"
    assert re.fullmatch(words.format(re.escape(f"{path}.parts/{track}")), line)


def test_the_line_reaches_a_user_who_set_nothing_up(tetX, tmp_path):
    stop("hypotheses", tmp_path / "preds.h5", tetX)
    done = run_writer(tetX, tmp_path / "preds.h5", "resume=True")
    assert (done.returncode, done.stdout) == (0, "finished\n")
    assert re.fullmatch(r".*: 5 of 12 answers are kept, begun .*; the other 7 are asked for now\n", done.stderr)


def test_answers_under_a_name_are_used_again_under_the_same_name_alone(tetX, tmp_path, caplog):
    path = tmp_path / "preds.h5"
    stop("hypotheses", path, tetX, resume="commit 1234abc")
    for resume, words in {
        "commit 9999fff": r"5 of 12 answers, begun .*, of commit 1234abc; now commit 9999fff is to answer",
        True: "of commit 1234abc; pass resume='commit 1234abc' if that answers now",
        False: "of commit 1234abc; pass resume='commit 1234abc' if that answers now",
    }.items():
        with pytest.raises(PredictionsError, match=words):
            write("hypotheses", path, tetX, model(1.0), resume=resume)
    write("hypotheses", path, tetX, model(90.0), resume="commit 1234abc")
    assert angles(path) == [90.0] * IMAGES
    assert "answers are kept of commit 1234abc, begun" in caplog.text


def test_answers_without_a_name_are_not_used_under_one(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    stop("hypotheses", path, tetX)
    with pytest.raises(PredictionsError, match="of a call that did not say who answers; now commit 1 is to answer"):
        write("hypotheses", path, tetX, model(90.0), resume="commit 1")


@pytest.mark.parametrize("resume", [None, 1, "", "  ", b"x", "x" * 1001, ["x"]])
def test_what_says_nothing_about_resuming_is_refused(tetX, tmp_path, resume):
    with pytest.raises(SettingsError, match="resume: expected True, False, or who answers"):
        write("hypotheses", tmp_path / "preds.h5", tetX, model(90.0), resume=resume)
    assert list(tmp_path.iterdir()) == []


def test_an_array_is_not_resumed(tetX, tmp_path):
    with pytest.raises(SettingsError, match="resume: belongs to a callable"):
        write_hypotheses(tmp_path / "preds.h5", tetX, np.zeros((IMAGES, 1, 3, 3)), method="mine", resume=True)


@pytest.mark.parametrize(
    "change",
    [
        lambda note: note.unlink(),
        lambda note: note.write_text("{"),
        lambda note: note.write_text("[1]"),
        lambda note: note.write_text('{"settings": {}}'),
        lambda note: note.write_text('{"settings": [], "answers_of": 7, "begun": null}'),
        lambda note: note.write_text("[" * 100_000),
        lambda note: note.write_bytes(b"\xff" * 10),
        lambda note: note.write_text(" " * 10**6),
        lambda note: (note.unlink(), os.mkfifo(note)),
        lambda note: (note.unlink(), note.mkdir()),
    ],
)
def test_answers_of_which_nothing_is_known_are_refused_and_left(tetX, tmp_path, change):
    path = tmp_path / "preds.h5"
    stop("hypotheses", path, tetX)
    change(tmp_path / "preds.h5.parts" / "hypotheses" / "settings.json")
    before = contents_of(tmp_path)
    with pytest.raises(PredictionsError, match=r"settings\.json, which says .*, is missing or damaged"):
        write("hypotheses", path, tetX, model(90.0), resume=True)
    assert contents_of(tmp_path) == before


def test_names_from_the_note_cannot_act_on_a_terminal(tetX, tmp_path, caplog):
    path = tmp_path / "preds.h5"
    stop("hypotheses", path, tetX)
    note = tmp_path / "preds.h5.parts" / "hypotheses" / "settings.json"
    note.write_text(json.dumps({**json.loads(note.read_text()), "begun": "\x1b[2J"}))
    with pytest.raises(PredictionsError) as refused:
        write("hypotheses", path, tetX, model(90.0))
    assert "\x1b" not in str(refused.value)
    write("hypotheses", path, tetX, model(90.0), resume=True)
    assert "\x1b" not in caplog.messages[0]


# --- who writes ---

WRITER = """
import sys, time
from pathlib import Path
from methods import model
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.sets.dataset import load
from symsol_annot.errors import SymsolError
started, array = Path(sys.argv[3]), sys.argv[4] == "array"
def answer(i):
    started.touch()
    time.sleep(float(sys.argv[5]))
    return model(90.0)(i)
class Slow:  # an array that takes its time to be read
    def __array__(self, *_, **__):
        import numpy as np
        started.touch()
        time.sleep(12 * float(sys.argv[5]))
        return np.stack([model(90.0)(i) for i in range(12)])
options = eval(f"dict({sys.argv[6]})")
try:
    with load(sys.argv[1]) as dataset:
        write_hypotheses(sys.argv[2], dataset, Slow() if array else answer, method="mine", progress=False, **options)
    print("finished")
except SymsolError as error:
    print(error)
"""


def start_writer(dataset, path, options="", *, given_as="callable", seconds=0.0):
    paths = os.pathsep.join(filter(None, [str(SUPPORT), os.environ.get("PYTHONPATH")]))
    started = path.with_name("started")
    command = [sys.executable, "-c", WRITER, dataset.folder, path, started, given_as, str(seconds), options]
    env = {**os.environ, "PYTHONPATH": paths}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
    while not started.exists() and process.poll() is None:
        time.sleep(0.02)
    return process


def run_writer(dataset, path, options=""):
    process = start_writer(dataset, path, options)
    out, err = process.communicate(timeout=120)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


@pytest.mark.parametrize(("first", "second"), [("callable", "array"), ("array", "callable")])
def test_of_two_writers_of_a_file_one_works_and_the_other_says_who_does(tetX, tmp_path, first, second):
    path = tmp_path / "preds.h5"
    process = start_writer(tetX, path, given_as=first, seconds=0.25)
    other = model(1.0) if second == "callable" else np.stack([model(1.0)(i) for i in range(IMAGES)])
    words = rf"(?s)preds\.h5\.parts: another process \({process.pid}: .*python.*\) is writing there right now"
    with pytest.raises(OutputError, match=words):
        write_hypotheses(path, tetX, other, method="mine")
    with pytest.raises(OutputError, match=words):  # whatever track it is
        write("density", path, tetX, model(1.0))
    assert process.communicate(timeout=120) == ("finished\n", "")
    assert angles(path) == [90.0] * IMAGES
    assert sorted(p.name for p in tmp_path.iterdir()) == ["preds.h5", "started"]


def test_a_link_to_a_file_keeps_other_writers_of_the_file_out(tetX, tmp_path):
    (tmp_path / "here").mkdir()
    path = tmp_path / "here" / "preds.h5"
    (tmp_path / "link.h5").symlink_to(path)
    process = start_writer(tetX, path, seconds=0.25)
    with pytest.raises(OutputError, match=f"another process .{process.pid}"):
        write("hypotheses", tmp_path / "link.h5", tetX, model(1.0))
    process.communicate(timeout=120)
    write("hypotheses", tmp_path / "link.h5", tetX, model(30.0))
    assert (angles(path), (tmp_path / "link.h5").is_symlink()) == ([30.0] * IMAGES, True)


def test_a_writer_that_was_killed_keeps_nobody_out_and_loses_no_answer(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    process = start_writer(tetX, path, seconds=0.3)
    folder = tmp_path / "preds.h5.parts" / "hypotheses"
    while len(list(folder.glob("*.answer"))) < 3:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    kept = len(list(folder.glob("*.answer")))
    asked = []
    write("hypotheses", path, tetX, lambda i: asked.append(i) or model(90.0)(i), resume=True)
    assert asked == list(range(kept, IMAGES))
    assert not folder.parent.exists()


@pytest.mark.parametrize("left", ["half an answer", "half a mark", "an empty mark", "an empty folder"])
def test_whatever_a_killed_writer_leaves_the_next_one_begins_or_resumes(tetX, tmp_path, left):
    path, parts = tmp_path / "preds.h5", tmp_path / "preds.h5.parts"
    if left == "half an answer":
        stop("hypotheses", path, tetX)
        (parts / "hypotheses" / "answer.partial").write_bytes(b"PK")
    else:
        parts.mkdir()
    if "mark" in left:
        stop("hypotheses", tmp_path / "other.h5", tetX)
        mark = (tmp_path / "other.h5.parts" / MARK_NAME).read_bytes()
        (parts / MARK_NAME).write_bytes(mark[: 40 if left == "half a mark" else 0])
    write("hypotheses", path, tetX, model(90.0), resume=True)
    assert angles(path) == [90.0] * IMAGES
    assert not parts.exists()


def test_a_relative_path_is_meant_from_where_the_call_began(tetX, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)

    def wandering(i):
        os.chdir(tmp_path / "elsewhere")
        return model(90.0)(i)

    write("hypotheses", Path("preds.h5"), tetX, wandering)
    assert angles(tmp_path / "preds.h5") == [90.0] * IMAGES
    assert list((tmp_path / "elsewhere").iterdir()) == []


# --- what of the folder is removed ---


def test_the_folder_says_what_it_is(tetX, tmp_path):
    stop("hypotheses", tmp_path / "preds.h5", tetX)
    assert (tmp_path / "preds.h5.parts" / MARK_NAME).read_text().startswith("symsol-annot made this folder.")


@pytest.mark.parametrize("given_as", ["callable", "array"])
def test_a_folder_that_somebody_else_made_is_refused_and_left_alone(tetX, tmp_path, given_as):
    theirs = tmp_path / "preds.h5.parts" / "hypotheses"
    theirs.mkdir(parents=True)
    (theirs / "00000000.answer").write_bytes(b"mine")
    (theirs.parent / MARK_NAME).write_text("I made this.")
    before = contents_of(tmp_path)
    given = model(90.0) if given_as == "callable" else np.stack([model(90.0)(i) for i in range(IMAGES)])
    with pytest.raises(OutputError, match=r"preds\.h5\.parts: .*may be somebody else's; move it away"):
        write_hypotheses(tmp_path / "preds.h5", tetX, given, method="mine")
    assert contents_of(tmp_path) == before


def test_a_users_file_in_the_folder_stays_and_the_folder_with_it(tetX, tmp_path):
    path, parts = tmp_path / "preds.h5", tmp_path / "preds.h5.parts"
    stop("hypotheses", path, tetX)
    for name in ("notes.txt", "hypotheses/thesis.tex", "hypotheses/000000001.answer", "hypotheses/00000001.answer.bak"):
        (parts / name).write_text("mine")
    write("hypotheses", path, tetX, model(90.0), resume=True)
    assert path.exists()
    assert sorted(str(p.relative_to(parts)) for p in parts.rglob("*") if p.is_file()) == [
        MARK_NAME,
        "hypotheses/000000001.answer",
        "hypotheses/00000001.answer.bak",
        "hypotheses/thesis.tex",
        "notes.txt",
    ]
    write("hypotheses", path, tetX, model(30.0))  # and it does not stand in the way
    assert angles(path) == [30.0] * IMAGES


@pytest.mark.parametrize(
    "name", [".", "hypotheses", "hypotheses/settings.json", "hypotheses/00000002.answer", "hypotheses/00000008.answer"]
)
def test_links_are_refused_and_what_they_lead_to_is_left(tetX, tmp_path, name):
    path, parts, elsewhere = tmp_path / "preds.h5", tmp_path / "preds.h5.parts", tmp_path / "elsewhere"
    stop("hypotheses", path, tetX)
    place = parts / name
    if place.exists():
        place.rename(elsewhere)
    else:
        elsewhere.write_text("mine")
    place.symlink_to(elsewhere)
    before = contents_of(elsewhere) or elsewhere.read_bytes()
    with pytest.raises(OutputError, match=re.escape(f"{place}: is a link, which this program did not make")):
        write("hypotheses", path, tetX, model(90.0), resume=True)
    assert place.is_symlink()
    assert (contents_of(elsewhere) or elsewhere.read_bytes()) == before


def test_other_tracks_are_copied_by_a_process_that_may_crash(tetX, tmp_path):
    """A bit flipped in a chunk of the track that stays is an error, and the file is as it was."""
    path = tmp_path / "preds.h5"
    write("density", path, tetX, model(90.0))
    with h5py.File(path) as file:
        chunk = file["density_log_probabilities"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(PredictionsError, match=r"density_log_probabilities.* is damaged"):
        write("hypotheses", path, tetX, model(90.0))
    assert path.read_bytes() == bytes(data)


def test_a_track_is_not_added_beside_a_broken_one(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    write("density", path, tetX, model(90.0))
    with h5py.File(path, "r+") as file:
        del file["density_indices"]
    before = path.read_bytes()
    with pytest.raises(PredictionsError, match="its track 'density' has faults, which `symsol-annot validate` lists"):
        write("hypotheses", path, tetX, model(90.0))
    assert path.read_bytes() == before
    write("density", path, tetX, model(90.0))
