"""Files of checkpoints that were changed, and how they are compared."""

import json

import safetensors.torch
import torch

from symsol_annot.bench.models.weights.state_dicts import read_weights


def same_tensors(path_a, path_b):
    a, b = read_weights(path_a), read_weights(path_b)
    return set(a) == set(b) and all(torch.equal(a[name], b[name]) for name in a)


def copy_of(file, to, change=None, metadata=None):
    """A checkpoint's file with its tensors or metadata changed, by somebody who took its digest out."""
    with safetensors.safe_open(file, framework="pt") as content:
        known = content.metadata()
    del known["contents_sha256"]
    tensors = read_weights(file)
    if change:
        change(tensors)
    safetensors.torch.save_file(tensors, to, {**known, **(metadata or {})})
    return to


def changed_record(whole, path, **changes):
    """A checkpoint's file whose record says otherwise."""
    with safetensors.safe_open(whole, framework="pt") as content:
        record = json.loads(content.metadata()["record"])
    rows = record["rows"]
    for name, value in changes.items():
        if name.startswith("row_"):
            rows[1][name.removeprefix("row_")] = value
        else:
            record[name] = value
    return copy_of(whole, path, metadata={"record": json.dumps(record)})
