"""Faults of the folder that a set is made in: full and read-only disks, damage, files in the way, two at once.

python tools/soak/folder_faults.py [--only WORDS]

Each ends in a message that says what to do and in a set that resumes, and leaves nothing behind. It needs root: to
mount small disks, and to do without the rights that root has.
"""

import os
import signal
import subprocess
import time
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from outcomes import run_alone
from processes import contents, finished, kill
from trials import HERE, SET, try_all, undisturbed_set

UNPRIVILEGED = ("setpriv", "--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-dac_override,-dac_read_search")
FULL = "cannot be written: the disk is full: make room, then run the same command again"
NO_TEMPORARY = (
    "temporary files cannot be written",
    "set TMPDIR to another folder",
    "re-running the command resumes it",
)
NO_PERMISSION = "cannot be written: no write permission: choose another folder with --out, or change its permissions"


def prove(table, only):
    """Suffer all faults whose names have some words."""
    try_all(table, [fault for fault in FAULTS if only in f"{fault[0]}: {fault[1]}"], undisturbed_set())
    return {"set": SET}


# The disk


@contextmanager
def disk(folder, options):
    """Mount a small disk in memory; what remounts it with other options, and tells whether it could, is given."""

    def mount(options):
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
        return subprocess.run(command, check=False, capture_output=True).returncode == 0

    if not mount(options):
        raise PermissionError("no small disk can be mounted; run as root")
    try:
        yield lambda options: mount(f"remount,{options}")
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def full_in_the_middle(trial):
    with disk(trial.site.out, "size=200k") as remount:
        trial.refuses(trial.start(), FULL)
        trial.expect(finished(trial.folder), "no finished shard was kept")
        remount("size=4m")
        trial.resumes()


def full_from_the_start(trial):
    with disk(trial.site.out, "size=4k") as remount:
        ballast = trial.site.out / "ballast"
        ballast.write_bytes(bytes(4096))
        trial.refuses(trial.start(), FULL)
        trial.expect(not trial.folder.exists(), "an empty folder is left")
        ballast.unlink()
        remount("size=4m")
        trial.resumes()


def out_of_inodes(trial):
    with disk(trial.site.out, "size=4m,nr_inodes=9") as remount:
        trial.refuses(trial.start(), FULL)
        trial.expect(finished(trial.folder), "no finished shard was kept")
        remount("size=4m,nr_inodes=100")
        trial.resumes()


def full_temporary_folder(trial):
    ballast = []
    with disk(trial.site.temporary, "nr_inodes=50"):
        running = trial.started("--worker-frames", "1")  # a new worker for each shard
        while running.is_running:
            with suppress(OSError):
                path = trial.site.temporary / f"ballast-{len(ballast)}"
                path.touch()
                ballast.append(path)
        trial.refuses(running, *NO_TEMPORARY, "No space left on device")
        for path in ballast:
            path.unlink()
        trial.resumes()
        left = list(trial.site.temporary.iterdir())
        trial.expect(not left, f"a file is left: {left}")


def read_only_disk(trial):
    with disk(trial.site.out, "size=4m") as remount:
        running = trial.started()
        while not remount("size=4m,ro") and running.is_running:  # busy while a file is open
            time.sleep(0.01)
        trial.refuses(running, "cannot be written: the file system is read-only: choose another folder with --out")
        remount("size=4m,rw")
        trial.resumes()


# Permissions


def read_only_folder(trial):
    trial.folder.mkdir()
    trial.folder.chmod(0o555)
    trial.refuses(trial.start(before=UNPRIVILEGED), NO_PERMISSION)
    trial.folder.chmod(0o755)
    trial.resumes(before=UNPRIVILEGED)


def read_only_parent(trial):
    trial.site.out.chmod(0o555)
    trial.refuses(trial.start(before=UNPRIVILEGED), NO_PERMISSION)
    trial.site.out.chmod(0o755)
    trial.resumes(before=UNPRIVILEGED)


def read_only_from_the_middle(trial):
    running = trial.started(before=UNPRIVILEGED)
    trial.folder.chmod(0o555)
    trial.refuses(running, NO_PERMISSION)
    trial.folder.chmod(0o755)
    trial.resumes(before=UNPRIVILEGED)


def read_only_temporary_folder(trial):
    running = trial.started("--worker-frames", "1", before=UNPRIVILEGED)  # a new worker for each shard
    trial.site.temporary.chmod(0o555)
    trial.refuses(running, *NO_TEMPORARY, "Permission denied")
    trial.site.temporary.chmod(0o755)
    trial.resumes(before=UNPRIVILEGED)


# Damage


def damaged_shard(damage, trial):
    trial.resumes()
    shard, before = sorted(trial.folder.glob("*.h5"))[3], finished(trial.folder)
    damage(shard)
    trial.refuses(trial.start(), f"damaged: {shard.name}", "--repair makes them again, to the same bytes")
    trial.resumes("--repair")
    after = finished(trial.folder)
    changed = [name for name, status in before.items() if after[name] != status]
    trial.expect(changed == [shard.name], f"expected {shard.name} to be made again, found {changed}")


def flip_a_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


# Files in the way


def begun(trial):
    """Begin a set, kill the command, and return the name of a shard that is not made."""
    running = trial.started()
    os.kill(running.pid, signal.SIGKILL)
    running.end()
    return next(
        f"test-{n:05d}-of-00008.h5"
        for n in range(7, -1, -1)
        if f"test-{n:05d}-of-00008.h5" not in finished(trial.folder)
    )


def foreign_file(make, trial):
    name = begun(trial)
    mine = make(trial, name)
    (trial.folder / name).write_bytes(mine)
    words = (
        "holds files that are no shards of this set",
        name,
        "move them elsewhere, or give --repair to replace them",
    )
    trial.refuses(trial.start(), *words)
    trial.expect((trial.folder / name).read_bytes() == mine, "the foreign file was touched")
    trial.resumes("--repair")


def text(trial, name):
    return b"mine\n"


def other_shard(trial, name):
    other = trial.site.folder / "other"
    trial.site.render(SET, *HERE, "--seed", "1", out=other).end()
    return (other / "tetX" / name).read_bytes()


def link_for_a_shard(trial):
    link, outside = trial.folder / begun(trial), trial.site.folder / "outside"
    outside.write_text("mine\n")
    refuses_link(trial, link, outside, "--repair")
    link.unlink()
    trial.resumes()


def link_for_the_manifest(trial):
    begun(trial)
    link, outside = trial.folder / "manifest.json", trial.site.folder / "outside"
    link.rename(outside)
    refuses_link(trial, link, outside)
    outside.rename(link)
    trial.resumes()


def refuses_link(trial, link, outside, *options):
    link.symlink_to(outside)
    before = outside.read_bytes()
    words = (f"{link.name}: is a symbolic link to", "outside the set's folder; nothing was written. Remove the link")
    trial.refuses(trial.start(*options), *words)
    trial.expect(outside.read_bytes() == before and link.is_symlink(), "the file outside, or the link, was touched")


def another_set(trial):
    begun(trial)
    before = contents(trial.folder)
    words = ("already holds another set; nothing was touched", "seed: there 0, asked for 1", "Use another --out folder")
    trial.refuses(trial.start("--seed", "1"), *words)
    trial.expect(contents(trial.folder) == before, "the set was touched")
    trial.resumes()


def two_commands(trial):
    first = trial.started()
    workers = trial.site.blenders()
    kill(workers, signal.SIGSTOP)  # the first one waits for the second
    trial.refuses(trial.start(), "is writing there right now; wait for it, or choose another place with --out")
    kill(workers, signal.SIGCONT)
    trial.survives(first)


FAULTS = (
    ("disk full", "in the middle of the set", full_in_the_middle),
    ("disk full", "from the start", full_from_the_start),
    ("disk full", "no inode left", out_of_inodes),
    ("disk full", "TMPDIR, in the middle", full_temporary_folder),
    ("read-only file system", "in the middle", read_only_disk),
    ("read-only folder", "the set's", read_only_folder),
    ("read-only folder", "the one that the set's goes into", read_only_parent),
    ("read-only folder", "the set's, in the middle", read_only_from_the_middle),
    ("read-only folder", "TMPDIR, in the middle", read_only_temporary_folder),
    ("damaged shard", "a bit flipped", partial(damaged_shard, flip_a_bit)),
    ("damaged shard", "cut off", partial(damaged_shard, partial(os.truncate, length=1000))),
    ("damaged shard", "deleted", partial(damaged_shard, Path.unlink)),
    ("foreign file under a shard's name", "text", partial(foreign_file, text)),
    ("foreign file under a shard's name", "another set's shard", partial(foreign_file, other_shard)),
    ("symbolic link out of the folder", "under a shard's name", link_for_a_shard),
    ("symbolic link out of the folder", "under the manifest's name", link_for_the_manifest),
    ("another set in the folder", "another seed", another_set),
    ("two commands, one folder", "at the same time", two_commands),
)


if __name__ == "__main__":
    run_alone(__doc__, "folder_faults", prove, only="")
