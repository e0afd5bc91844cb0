"""What files of unknown origin do: a small seed of `make attack`, and that its judge sees what it is there to see."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from attack import bombs, harness, laws, odd_shards, signing
from attack.apart import SilentError
from attack.hdf5_fields import damage_fields, fields_of, with_right_checksums
from attack.places import CASES
from made_sets import make_set

from symsol_annot.sets.manifest import read_manifest

TOOLS = Path(__file__).parents[2] / "tools"
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="attempts are watched with what Linux has")
SEEDED = (
    *("shards", "shards, signed again", "manifests, signed again", "found before", "objects", "zips"),
    *("archives", "BOP folders", "mesh files"),
)


@LINUX
def test_no_damaged_file_crashes_hangs_deceives_or_escapes(tmp_path):
    found = harness.attack(tmp_path / "work", TOOLS.parent, SEEDED, scale=0.005, seed=1, jobs=2)
    assert harness.failures(found) == 0, [row["failures"] for row in found["kinds"].values()]
    assert all(row["ends"].get("refused") for row in found["kinds"].values())
    assert found["kinds"]["shards"]["cases"] == 20


# The judge

JUDGED = """
import json, os, signal, sys, time
from pathlib import Path
from attack import apart, places
from symsol_annot.errors import DataError

def loop():
    while True:
        pass

def deaf():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    loop()

def grow():
    return "right" if b"x" * 2**28 else "refused"

def grow_in_a_child():
    if os.fork() == 0:
        grow()
        os._exit(0)
    os.wait()
    return "right"

def leave_a_child():
    if os.fork() == 0:
        time.sleep(600)
    return "right"

def refuse():
    raise DataError("is damaged")

def refuse_unprintably():
    class Loud(DataError):
        def __str__(self):
            return "\\x1b[2J"
    raise Loud("")

def deceive():
    raise apart.SilentError("zeros")

ACTIONS = {
    "returns": lambda: "right",
    "refuses": refuse,
    "fails": lambda: 1 / 0,
    "exits": lambda: sys.exit(0),
    "crashes": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "vanishes": lambda: os._exit(3),
    "loops": loop,
    "loops, deaf": deaf,
    "waits": lambda: time.sleep(600),
    "grows": grow,
    "grows in a child": grow_in_a_child,
    "leaves a child": leave_a_child,
    "deceives": deceive,
    "is loud": refuse_unprintably,
    "warns": lambda: __import__("warnings").warn("odd"),
}
apart.adopt_orphans()
for name, action in ACTIONS.items():
    ended = apart.run_apart(action, Path(sys.argv[1]) / "said", 1.0, 2**28)
    print(json.dumps([name, ended.how, ended.words, ended.seconds, ended.peak_bytes]))
"""
EXPECTED = {
    "returns": "right",
    "refuses": "refused",
    "fails": "TRACEBACK",
    "exits": "TRACEBACK",
    "crashes": "CRASH",
    "vanishes": "CRASH",
    "loops": "HANG",
    "loops, deaf": "HANG",
    "waits": "HANG",
    "grows": "PEAK",
    "grows in a child": "PEAK",
    "leaves a child": "HANG",
    "deceives": "SILENT",
    "is loud": "ESCAPE",
    "warns": "TRACEBACK",
}


@LINUX
def test_each_way_to_end_is_told_from_the_others(tmp_path):
    done = python(JUDGED, tmp_path)
    ended = {name: (how, words) for name, how, words, *_ in map(json.loads, done.stdout.splitlines())}
    assert {name: how for name, (how, _) in ended.items()} == EXPECTED
    assert ended["crashes"][1] == "SIGSEGV"
    assert ended["loops"][1].endswith("Ctrl-C ends it")
    assert ended["loops, deaf"][1].endswith("Ctrl-C is ignored")


SURROUNDED = """
import os, sys
from pathlib import Path
from attack.places import Place, Surroundings

place = Place(Path(sys.argv[1]) / "root")
place.prepare()
place.clear()
surroundings = Surroundings(place)
ACTIONS = {
    "writes where it may": lambda: (place.out / "x").write_text("x"),
    "reads the case": lambda: (place.case / "case.h5").read_bytes(),
    "opens a canary": lambda: (place.outside / "canary.h5").read_bytes(),
    "opens a canary in the case": lambda: (place.case / "canary.h5").read_bytes(),
    "writes at home": lambda: Path("made").write_text("x"),
    "writes above": lambda: (place.root / "made").write_text("x"),
    "changes the case": lambda: (place.case / "case.h5").write_text("y"),
    "removes a canary": lambda: (place.outside / "canary.h5").unlink(),
}
for name, action in ACTIONS.items():
    for file in ("case.h5", "canary.h5"):
        (place.case / file).write_text("x")
    surroundings.begin()
    action()
    print(name, "|", "; ".join(surroundings.wrongs()))
"""


@LINUX
def test_what_is_opened_or_changed_outside_is_seen(tmp_path):
    lines = dict(line.split(" | ") for line in python(SURROUNDED, tmp_path).stdout.splitlines())
    assert lines == {
        "writes where it may": "",
        "reads the case": "",
        "opens a canary": "opened canary.h5",
        "opens a canary in the case": "opened canary.h5",
        "writes at home": "changed deep/down/home/made",
        "writes above": "changed made",
        "changes the case": "changed deep/down/case/case.h5",
        "removes a canary": "changed deep/down/outside/canary.h5",
    }


def test_labels_that_no_set_can_have_are_seen():
    group = np.stack([np.diag(signs) for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]).astype(float)
    laws.check_group(group)
    for broken in (group[:3], group[[1, 0, 2, 3]], -group, 1.1 * group, group * np.nan, group[:0]):
        with pytest.raises(SilentError):
            laws.check_group(broken)


# The damage


@pytest.fixture(scope="module")
def tetX(tmp_path_factory):
    return make_set(tmp_path_factory.mktemp("attacked"), "tetX", test=6, size=16)


def test_fields_are_where_hdf5_has_them(tetX):
    (path,) = tetX.glob("*.h5")
    content = path.read_bytes()
    fields = fields_of(content)
    at = {kind: {field.offset: field for field in fields if field.kind == kind} for kind in {f.kind for f in fields}}
    numbers = {kind: [int.from_bytes(content[o : o + f.size], "little") for o, f in at[kind].items()] for kind in at}
    with h5py.File(path) as file:
        chunks = []
        for name in file:
            file[name].id.chunk_iter(chunks.append)
    assert sorted(numbers["chunk: size"]) == sorted(chunk.size for chunk in chunks)
    assert {chunk.byte_offset for chunk in chunks} <= set(numbers["tree: child"])
    assert numbers["end of file"] == [len(content)]


def test_damage_to_fields_changes_few_bytes_and_depends_on_the_seed_alone(tetX):
    (path,) = tetX.glob("*.h5")
    whole, fields = path.read_bytes(), fields_of(path.read_bytes())
    for seed in range(20):
        twice = [bytearray(whole), bytearray(whole)]
        done = [damage_fields(content, fields, np.random.default_rng(seed)) for content in twice]
        assert twice[0] == twice[1]
        assert done[0] == done[1]
        assert len(twice[0]) == len(whole)
        assert sum(a != b for a, b in zip(twice[0], whole, strict=True)) <= 48


def test_checksums_made_right_again_are_the_librarys(tmp_path):
    with h5py.File(tmp_path / "new.h5", "w", libver="latest") as file:
        file["rows"] = np.arange(3)
        file.attrs["name"] = "x"
    content = (tmp_path / "new.h5").read_bytes()
    assert with_right_checksums(content) == content
    at = content.index(b"OHDR")
    wrong = content[: at + 40] + bytes([content[at + 40] ^ 1]) + content[at + 41 :]
    assert with_right_checksums(wrong) != wrong


def test_a_set_that_is_signed_again_has_right_digests(tetX, tmp_path):
    folder = tmp_path / "tetX"
    folder.mkdir()
    for path in tetX.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    whole = read_manifest(folder)
    signing.sign(folder, signing.read_document(folder))
    assert read_manifest(folder) == whole
    document = signing.read_document(folder)
    document["seed"] += 1
    signing.sign(folder, document)
    assert read_manifest(folder).fingerprint != whole.fingerprint


def test_each_oddity_can_be_written(tetX, tmp_path):
    """One that never is would be no attack."""

    class Place:
        outside, case = tmp_path, tmp_path

    (path,) = tetX.glob("*.h5")
    never = []
    for change in dict.fromkeys(odd_shards.CHANGES):
        copied = tmp_path / "odd.h5"
        copied.write_bytes(path.read_bytes())
        for seed in range(20):
            try:
                with h5py.File(copied, "r+") as file:
                    change(file, Place, np.random.default_rng(seed))
                break
            except odd_shards.WRITE_ERRORS:
                continue
        else:
            never.append(change.__name__)
    assert never == []


def test_cases_are_those_that_their_digests_stand_for():
    (entry,) = json.loads((CASES / "manifest.json").read_text())["splits"]["test"]["shards"]
    assert hashlib.sha256((CASES / "shard.h5").read_bytes()).hexdigest() == entry["sha256"]
    for content in bombs.damaged_shards().values():
        assert len(content) == entry["bytes"]
        assert hashlib.sha256(content).hexdigest() != entry["sha256"]


def test_streams_of_zeros_are_what_zlib_makes():
    import zlib

    stream = bombs.zeros_after(b"head", 2**24 + 5)
    assert zlib.decompress(stream) == b"head" + bytes(2**24 + 5)


def test_a_bombs_checksum_is_hdf5s(tmp_path):
    for length in (1, 2, 1001, 200_000):
        data = np.random.default_rng(length).bytes(length)
        with h5py.File(tmp_path / "x.h5", "w") as file:
            rows = file.create_dataset("rows", (length,), "u1", chunks=(length,), fletcher32=True)
            rows.id.write_direct_chunk((0,), data + bombs.fletcher32(data).to_bytes(4, "little"))
            assert rows[...].tobytes() == data


def python(code, folder):
    """Run code beside the attack's modules, to a good end."""
    paths = os.pathsep.join([str(TOOLS), str(TOOLS.parent / "tests" / "support")])
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done
