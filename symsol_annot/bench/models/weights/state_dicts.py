"""State dicts, tensors by their names: read without running what a file holds, written, and checked against a model."""

import os
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

import safetensors.torch
import torch
from torch import nn

from symsol_annot.bench.models.weights.pickle_child import TENSORS
from symsol_annot.bench.models.weights.safetensors_file import Content, StateDict, parse_content, read_content
from symsol_annot.errors import WeightsError, bulleted, first_of
from symsol_annot.system.files import write_atomically
from symsol_annot.system.reading import open_regular

_NAMES_SHOWN = 3
_CHILD = Path(__file__).with_name("pickle_child.py")
_PICKLE_SECONDS = 8.0  # of processor time; torchvision's file takes 0.1
_PICKLE_BYTES = 2**27  # of all tensors; torchvision's have 47 MB
_PICKLE_MEMORY_BYTES = 6 * _PICKLE_BYTES  # what is read, a copy of it, and the answer
_PICKLE_ADVICE = "get the file again, or save the model's state_dict() alone"


def read_weights(path: Path) -> StateDict:
    """Return the tensors of a file by their names, on the CPU; code in the file is never run.

    Args:
        path: a .safetensors file, or what torch.save made of a state dict, which a process with limits reads.

    Raises:
        WeightsError: there is no such file, it is damaged, or holds something else.
    """
    try:
        return read_content(path).tensors if path.suffix == ".safetensors" else _unpickled(path).tensors
    except FileNotFoundError:
        raise WeightsError(f"{path}: there is no such file of weights; check the path") from None
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise WeightsError(f"{path}: is damaged, or no file of weights ({error}); get the file again") from None


def write_weights(path: Path, model: nn.Module) -> None:
    """Write a model's weights and running statistics as a .safetensors file, whole or not at all.

    Raises:
        WeightsError: the name does not end in .safetensors.
        OutputError: the file cannot be written.
    """
    if path.suffix != ".safetensors":
        raise WeightsError(f"{path}: weights are written as safetensors; let the name end in .safetensors")
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}
    write_atomically(path, safetensors.torch.save(tensors))


def load_weights(model: nn.Module, weights: Mapping[str, torch.Tensor], source: str, wanted: str) -> None:
    """Give a model its weights, after a check that they are exactly its own: names, shapes, types, finite numbers.

    Args:
        model: takes them; it is left as it was where they do not fit.
        weights: tensors by the names of the model's state_dict().
        source: where they come from, for an error message.
        wanted: what was expected there, for an error message.

    Raises:
        WeightsError: they do not fit; the message tells all that is wrong.
    """
    expected = model.state_dict()
    shared = [name for name in expected if name in weights]
    shapes = {name: f"{tuple(weights[name].shape)} in place of {tuple(expected[name].shape)}" for name in shared}
    other_shape = [name for name in shared if weights[name].shape != expected[name].shape]
    other_type = [name for name in shared if _kind(weights[name]) != _kind(expected[name])]
    alike = [name for name in shared if name not in {*other_shape, *other_type}]
    faults = [
        *_fault("missing", (name for name in expected if name not in weights)),
        *_fault("not expected", (name for name in weights if name not in expected)),
        *_fault("of another shape", (f"{name} {shapes[name]}" for name in other_shape)),
        *_fault("of another type", other_type),
        *_fault("not finite", (name for name in alike if not weights[name].to(expected[name].dtype).isfinite().all())),
    ]
    if faults:
        raise WeightsError(f"{source}: these are not {wanted}:\n" + bulleted(faults))
    model.load_state_dict(weights)


def _unpickled(path: Path) -> Content:
    """Return what a file of torch.save holds, as the process says that reads it."""
    descriptor = open_regular(path)
    try:
        if os.fstat(descriptor).st_size > 2 * _PICKLE_BYTES:
            raise ValueError(f"it has more than {2 * _PICKLE_BYTES:,} bytes")
        limits = map(str, (_PICKLE_SECONDS, _PICKLE_BYTES, _PICKLE_MEMORY_BYTES))
        child = subprocess.run(
            [sys.executable, "-P", str(_CHILD), *limits],
            stdin=descriptor,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is this process's to handle
            check=False,
        )
    finally:
        os.close(descriptor)
    if child.returncode != 0 or not child.stdout:
        raise WeightsError(
            f"{path}: is damaged: reading it took more than {_PICKLE_SECONDS:g} s or more memory than weights do; "
            f"{_PICKLE_ADVICE}"
        )
    if child.stdout[:1] != TENSORS:
        raise WeightsError(f"{path}: {child.stdout[1:].decode()}; {_PICKLE_ADVICE}")
    return parse_content(child.stdout[1:])


def _kind(tensor: torch.Tensor) -> str:
    return "real" if tensor.is_floating_point() else "complex" if tensor.is_complex() else "whole"


def _fault(what: str, names: Iterable[str]) -> list[str]:
    found = list(names)
    return [f"{len(found)} {what}: {first_of(found, _NAMES_SHOWN)}"] if found else []
