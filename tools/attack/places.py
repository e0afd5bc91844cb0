"""Where an attempt takes place, and what lies around it that must stay as it was, unopened."""

import contextlib
import ctypes
import os
import shutil
import stat
from dataclasses import dataclass
from pathlib import Path

CASES = Path(__file__).parent / "cases"
_IN_OPEN = 0x20
_ABSENT = Path("/symsol-annot-attack")  # what no file may make


@dataclass(frozen=True)
class Place:
    """The folders of an attempt.

    Attributes:
        root: above all of them; two levels up lead to nothing of anyone's.
        case: what is read.
        out: where output may go.
        outside: a folder that no file may lead to.
        said: a file for what is printed.
    """

    root: Path

    @property
    def case(self):
        return self._folder / "case"

    @property
    def out(self):
        return self._folder / "out"

    @property
    def outside(self):
        return self._folder / "outside"

    @property
    def home(self):
        return self._folder / "home"

    @property
    def temporary(self):
        return self._folder / "tmp"

    @property
    def said(self):
        return self.root / "said"

    @property
    def _folder(self):
        return self.root / "deep" / "down"

    def prepare(self):
        """Make all folders, and be at home in them."""
        for folder in (self.case, self.out, self.outside, self.home, self.temporary):
            folder.mkdir(parents=True, exist_ok=True)
        os.environ.update(HOME=str(self.home), TMPDIR=str(self.temporary))
        os.chdir(self.home)

    def clear(self):
        """Empty what an attempt may write to."""
        for folder in (self.case, self.out, self.temporary):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()


class Surroundings:
    """Tells what was opened or changed around an attempt.

    Files that are called canary.* are what hostile files point to; nobody has a reason to open one.
    """

    def __init__(self, place):
        self._place = place
        for name in ("canary.h5", "manifest.json", "object.toml"):
            (place.outside / name).write_bytes((CASES / "shard.h5").read_bytes())
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._descriptor = self._libc.inotify_init1(os.O_NONBLOCK)
        self._outside = self._libc.inotify_add_watch(self._descriptor, os.fsencode(place.outside), _IN_OPEN)
        self._before = {}

    def begin(self):
        """Note how things are."""
        self._libc.inotify_add_watch(self._descriptor, os.fsencode(self._place.case), _IN_OPEN)
        self._names()
        self._before = self._state()

    def wrongs(self):
        """Return what was opened or changed since, in words."""
        after = self._state()
        changed = sorted(name for name in {*after, *self._before} if after.get(name) != self._before.get(name))
        wrongs = [f"opened {name}" for name in sorted(self._names())] + [f"changed {name}" for name in changed]
        if _ABSENT.exists():
            wrongs.append(f"made {_ABSENT}")
        return wrongs

    def _state(self):
        """Return what lies around, but for folders that may be written to, by its path."""
        free, found = {self._place.out, self._place.temporary}, {}
        for folder, folders, files in os.walk(self._place.root):
            here = Path(folder)
            folders[:] = [name for name in folders if here / name not in free]
            for name in (*folders, *files):
                path = here / name
                if path != self._place.said:
                    found[str(path.relative_to(self._place.root))] = _status(path)
        return found

    def _names(self):
        events, found = b"", set()
        with contextlib.suppress(BlockingIOError):
            while True:
                events += os.read(self._descriptor, 65536)
        while events:
            watch, length = (int.from_bytes(events[at : at + 4], "little") for at in (0, 12))
            name = events[16 : 16 + length].rstrip(b"\0").decode(errors="replace")
            if watch == self._outside or name.startswith("canary."):
                found.add(name)
            events = events[16 + length :]
        return found - {""}


def _status(path):
    status = path.lstat()
    if stat.S_ISDIR(status.st_mode):
        return "folder"
    return status.st_mode, status.st_size, status.st_mtime_ns, status.st_ino


def keep(place, folder):
    """Keep a case: regular files of a few MiB, links, and the names of what is neither."""
    shutil.rmtree(folder, ignore_errors=True)
    for path in sorted(place.case.rglob("*")):
        to = folder / path.relative_to(place.case)
        to.parent.mkdir(parents=True, exist_ok=True)
        if path.is_symlink():
            to.symlink_to(path.readlink())
        elif path.is_file() and path.stat().st_size < 2**24:
            to.write_bytes(path.read_bytes())
        elif not path.is_dir():
            to.with_name(to.name + ".txt").write_text(f"{stat.filemode(path.stat().st_mode)} {path.stat().st_size}\n")
