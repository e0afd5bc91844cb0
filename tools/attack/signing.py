"""Digests made right again: what somebody does who changes a set and wants nobody to see it. Shares no code with it."""

import hashlib
import json
import os
import resource

import h5py
import numpy as np

from attack.damage import json_bytes, nested_deeply

_SECONDS, _MEMORY_BYTES = 5, 2**31
_GROUP = "symmetry_group"  # a data set in version 1
_IN_DIGEST = ("image", "segmentation", "depth", "rotation", "marking_pixels", "part_pixels", "symmetry_mask", _GROUP)
_MADE_FROM = ("object", "object_sha256", "seed", "camera")


def read_document(folder):
    """Return a set's manifest as JSON has it."""
    return json.loads((folder / "manifest.json").read_bytes())


def sign(folder, document, *, contents=True):
    """Write a manifest whose digests are right for what lies in the folder, as far as they can be computed.

    Args:
        folder: the set's.
        document: the manifest; it is changed.
        contents: compute content_sha256 too; without, it stays what it was.
    """
    for shards in _lists_of_shards(document):
        for entry in shards:
            _sign_entry(folder, entry, contents=contents)
    fingerprints = {split: _fingerprint(document, [split]) for split in _splits(document)}
    for split, fingerprint in fingerprints.items():
        document["splits"][split]["fingerprint"] = fingerprint
    document["fingerprint"] = _fingerprint(document, ["train", "test"])
    document.pop("manifest_sha256", None)
    document["manifest_sha256"] = _sha256_of_json(document)
    (folder / "manifest.json").write_bytes(json_bytes(document))


def sign_group(file):
    """Give the group of an open shard its digest, where it is an attribute."""
    if _GROUP in file.attrs:
        file.attrs[f"{_GROUP}_sha256"] = hashlib.sha256(np.asarray(file.attrs[_GROUP]).tobytes()).hexdigest()


def content_sha256(path):
    """Return the digest of a shard's arrays as h5py reads them, in a process that may crash; None where it does."""
    answers, answer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
            os.write(answer, _digest(path).encode())
        finally:
            os._exit(0)
    os.close(answer)
    with os.fdopen(answers, "rb") as pipe:
        found = pipe.read()
    os.waitpid(pid, 0)
    return found.decode() or None


def _digest(path):
    digest = hashlib.sha256()
    with h5py.File(path, "r") as file:
        for name in _IN_DIGEST:
            if name in file:
                column = file[name]
                digest.update(f"{name} {column.dtype.str} {column.shape}\n".encode())
                for start in range(0, len(column), 64):
                    digest.update(np.ascontiguousarray(column[start : start + 64]).tobytes())
        if _GROUP in file.attrs:
            group = np.asarray(file.attrs[_GROUP])
            digest.update(f"{_GROUP} {group.dtype.str} {group.shape}\n".encode() + group.tobytes())
    return digest.hexdigest()


def _splits(document):
    splits = document.get("splits")
    return [name for name, split in splits.items() if isinstance(split, dict)] if isinstance(splits, dict) else []


def _lists_of_shards(document):
    for name in _splits(document):
        shards = document["splits"][name].get("shards")
        yield [entry for entry in shards if isinstance(entry, dict)] if isinstance(shards, list) else []


def _sign_entry(folder, entry, *, contents):
    name = entry.get("file")
    path = folder / name if isinstance(name, str) and "\0" not in name and "/" not in name and name else None
    if path is None or entry.get("sha256") is None or len(name) > 200 or not path.is_file():
        return
    data = path.read_bytes()
    entry |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    if contents:
        entry["content_sha256"] = content_sha256(path) or entry.get("content_sha256")


def _fingerprint(document, splits):
    try:
        made_from = {key: document[key] for key in _MADE_FROM}
        shards = [(name, entry) for name in splits for entry in document["splits"].get(name, {}).get("shards", [])]
        contents = [[name, entry["first_index"], entry["images"], entry["content_sha256"]] for name, entry in shards]
        return (
            None if any(row[-1] is None for row in contents) else _sha256_of_json({**made_from, "contents": contents})
        )
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError):
        return document.get("fingerprint")


def _sha256_of_json(document):
    with nested_deeply():
        text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()
