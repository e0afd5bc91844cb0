"""The answers of a callable, kept beside a predictions file until every image was asked about.

    preds.h5.parts/MADE-BY-SYMSOL-ANNOT    says what the folder is
    preds.h5.parts/TRACK/settings.json     what was asked, who answers, since when
    preds.h5.parts/TRACK/NNNNNNNN.answer   what was answered about an image

The folder is also what a writer holds a lock on, whatever he writes. Only files of these names are ever removed, only
where the mark stands beside them, and never a link.
"""

import contextlib
import itertools
import json
import logging
import os
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.writing.answer_file import (
    MAX_ANSWER_BYTES,
    Answer,
    forms_and_data,
    inflated,
    packed,
)
from symsol_annot.errors import OutputError, PredictionsError, SettingsError, output_errors, printable
from symsol_annot.system.locks import held_folder
from symsol_annot.system.reading import read_bytes, read_text
from symsol_annot.system.scratch import MARK_NAME

_LOG = logging.getLogger(__name__)
_MARK = (
    "symsol-annot made this folder. It holds answers about single images until the predictions file beside it is\n"
    "written; then symsol-annot removes those files that it wrote. Delete the folder to have all images asked anew.\n"
)
_NOTE, _UNFINISHED = "settings.json", "answer.partial"
_ANSWER = re.compile(r"(\d{8})\.answer")
_SMALL_BYTES = 2**16
_LONGEST_NAME = 1000  # of who answers
_DAMAGE = (OSError, ValueError, KeyError, TypeError, zlib.error)  # what a damaged answer raises

Resume = bool | str


@dataclass(frozen=True)
class _Note:
    """What is known of the answers in a folder: the settings that they were asked under, who gave them, since when."""

    settings: dict[str, Any]
    answers_of: str | None
    begun: str

    @classmethod
    def from_json(cls, found: Any) -> "_Note":
        """Return what a file says.

        Raises:
            KeyError, TypeError, ValueError: it says something else.
        """
        note = cls(found["settings"], found["answers_of"], found["begun"])
        if isinstance(note.settings, dict) and isinstance(note.answers_of, str | None) and isinstance(note.begun, str):
            return note
        raise TypeError("its values are of other types")


@contextlib.contextmanager
def held_parts(predictions: Path) -> Iterator[Path]:
    """Hold the folder of parts of a predictions file for this process alone, and give its path.

    A link to a predictions file has the parts of the file that it leads to.

    Raises:
        OutputError: another process writes this predictions file, or what has the folder's name was not made by this
            program; that is left as it is.
    """
    folder = Path(f"{os.path.realpath(predictions)}.parts")
    with held_folder(folder):
        with output_errors(folder):
            _refuse_foreign(folder)
        yield folder


def check_resume(resume: Resume) -> None:
    """Refuse what is neither a flag nor the name of who answers.

    Raises:
        SettingsError: it is neither.
    """
    if isinstance(resume, bool) or (isinstance(resume, str) and 0 < len(resume.strip()) <= len(resume) < _LONGEST_NAME):
        return
    raise SettingsError(
        f"resume: expected True, False, or who answers in up to {_LONGEST_NAME} characters, found {resume!r:.100}"
    )


class KeptAnswers:
    """What was answered about the images of one track, a small file per image, in a folder that this process holds."""

    def __init__(self, parts: Path, track: str, images: int) -> None:
        self.folder, self._parts, self._images = parts / track, parts, images

    @property
    def images(self) -> int:
        """How many images the split has."""
        return self._images

    def begin(self, settings: dict[str, Any], resume: Resume) -> None:
        """Make the folder ready, and say in the log what is used again of an earlier call.

        Args:
            settings: what the answers depend on, as far as the program knows it; plain JSON.
            resume: False where no answer may be there; True where the caller vouches that he gave them; a string that
                names who answers, where those under the same name are used again.

        Raises:
            PredictionsError: answers are there that may be another model's; they are left as they are.
            OutputError: nothing can be written there.
        """
        with output_errors(self._parts):
            (self._parts / MARK_NAME).write_text(_MARK)  # which is there already, or nothing is
            self.folder.mkdir(exist_ok=True)
            _refuse_link(self.folder)
            self._remove(_UNFINISHED)
            kept = self.answered()
        settings = json.loads(json.dumps(settings))
        answers_of = resume if isinstance(resume, str) else None
        if not kept:
            note = {
                "settings": settings,
                "answers_of": answers_of,
                "begun": f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC",
            }
            with output_errors(self._parts):
                self._write_small(self.folder / _NOTE, json.dumps(note, indent=1).encode())
            return
        note_there = self._read_note()
        if fault := _reason_to_refuse(note_there, len(kept), self._images, settings, resume):
            raise PredictionsError(str(self.folder), [fault])
        whose, left = f" of {answers_of}" if answers_of else "", self._images - len(kept)
        line = f"{len(kept)} of {self._images} answers are kept{whose}, begun {note_there.begun}"
        _LOG.warning("%s", printable(f"{self.folder}: {line}; the other {left} are asked for now"))

    def answered(self) -> set[int]:
        """Return the images that were answered."""
        found = (_ANSWER.fullmatch(name) for name in os.listdir(self.folder))  # noqa: PTH208 - names alone
        return {int(match[1]) for match in found if match and int(match[1]) < self._images}

    def write(self, i: int, answer: Answer) -> None:
        """Keep what was answered about image i.

        It may be lost with the power: then it is asked for again.

        Raises:
            OutputError: it cannot be written.
        """
        with output_errors(self._path(i)):
            self._write_small(self._path(i), packed(answer))

    def lengths(self, name: str) -> npt.NDArray[np.int64]:
        """Return how many entries each image has under a name, (N,)."""
        forms = (self._forms(i)[0] for i in range(self._images))
        return np.array([of_image[name][2] for of_image in forms], dtype=np.int64)

    def each(self, name: str) -> Iterator[Array]:
        """Yield what each image has under a name, in the order of the images.

        Raises:
            PredictionsError: an answer is damaged; the message says how to mend it.
        """
        return (self._read(i, name) for i in range(self._images))

    def first(self, name: str) -> Array:
        """Return what the first image has under a name, for its shape and type."""
        return self._read(0, name)

    def forget(self) -> None:
        """Remove the answers, and the folders unless somebody else put something there."""
        names = [name for name in os.listdir(self.folder) if _ANSWER.fullmatch(name)]  # noqa: PTH208
        for name in (*names, _UNFINISHED, _NOTE):
            self._remove(name)
        with contextlib.suppress(OSError):  # somebody else's file is in it, or another track's answers beside it
            self.folder.rmdir()
            if os.listdir(self._parts) == [MARK_NAME]:  # noqa: PTH208
                (self._parts / MARK_NAME).unlink()
                self._parts.rmdir()

    def _remove(self, name: str) -> None:
        path = self.folder / name
        with contextlib.suppress(OSError):
            if not path.is_symlink():
                path.unlink()

    def _read_note(self) -> _Note:
        path = self.folder / _NOTE
        _refuse_link(path)
        try:
            return _Note.from_json(json.loads(read_text(path, _SMALL_BYTES)))
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            fault = f"{_NOTE}, which says what the answers beside it are about, is missing or damaged ({error})"
            raise PredictionsError(str(self.folder), [f"{fault}; delete the folder to begin anew"]) from None

    def _read(self, i: int, name: str) -> Array:
        forms, data = self._forms(i)
        with self._damage(i):
            start = sum(size for size, *_ in itertools.takewhile(lambda form: form is not forms[name], forms.values()))
            size, code, *shape = forms[name]
            return inflated(data[start : start + size], code, shape)

    def _forms(self, i: int) -> tuple[dict[str, list[Any]], memoryview]:
        path = self._path(i)
        _refuse_link(path)
        with self._damage(i):
            return forms_and_data(read_bytes(path, MAX_ANSWER_BYTES))

    @contextlib.contextmanager
    def _damage(self, i: int) -> Iterator[None]:
        """Turn what a damaged answer makes of numpy and zlib into an error that says what to do."""
        try:
            yield
        except _DAMAGE as error:
            fault = f"is damaged ({error}); delete it, and the same call asks about image {i} again"
            raise PredictionsError(str(self._path(i)), [fault]) from None

    def _write_small(self, path: Path, data: bytes) -> None:
        """Write a file of this folder, whole or not at all; nobody else writes in the folder."""
        _refuse_link(path)
        unfinished = path.with_name(_UNFINISHED)
        _refuse_link(unfinished)
        try:
            unfinished.write_bytes(data)
            unfinished.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                unfinished.unlink()
            raise

    def _path(self, i: int) -> Path:
        return self.folder / f"{i:08d}.answer"


def _reason_to_refuse(note: _Note, kept: int, images: int, settings: dict[str, Any], resume: Resume) -> str:
    """Say why the answers that are kept are not used for a call; "" where they are."""
    count = f"holds {kept} of {images} answers, begun {note.begun}"
    differences = [
        f"{name} there {note.settings.get(name)!r:.100}, now {settings.get(name)!r:.100}"
        for name in sorted({*note.settings, *settings})
        if note.settings.get(name) != settings.get(name)
    ]
    if differences:
        return (
            f"{count}, that are the beginning of other predictions ({'; '.join(differences)}); finish those, choose "
            "another file, or delete the folder to begin anew"
        )
    if isinstance(resume, str) and note.answers_of != resume:
        there = note.answers_of or "a call that did not say who answers"
        return (
            f"{count}, of {there:.{_LONGEST_NAME}}; now {resume} is to answer, and a file has one model's answers: "
            "finish those with the former, choose another file, or delete the folder to begin anew"
        )
    if note.answers_of is not None and resume != note.answers_of:
        return (
            f"{count}, of {note.answers_of:.{_LONGEST_NAME}}; pass resume={note.answers_of!r:.{_LONGEST_NAME}} if that "
            "answers now, or delete the folder to begin anew"
        )
    if resume is False:
        return (
            f"{count}, and nothing proves that they are of what is asked now; pass resume=True to keep them if they "
            "are, or delete the folder to begin anew"
        )
    return ""


def _refuse_foreign(parts: Path) -> None:
    """Refuse a folder that is neither empty nor marked as made by this program."""
    _refuse_link(parts)
    mark = parts / MARK_NAME
    with contextlib.suppress(OSError, UnicodeDecodeError):
        if not mark.is_symlink() and _MARK.startswith(read_text(mark, _SMALL_BYTES)):  # or cut, when it was killed
            return
    if os.listdir(parts):  # noqa: PTH208
        raise OutputError(
            f"{parts}: is where the answers about single images are kept until the predictions file is written, but "
            f"the folder that is there holds no {MARK_NAME} as this version writes it, so it may be somebody else's; "
            "move it away, or choose another file"
        )


def _refuse_link(path: Path) -> None:
    if path.is_symlink():
        raise OutputError(
            f"{path}: is a link, which this program did not make; nothing was written or removed. Remove the link, or "
            "choose another file"
        )
