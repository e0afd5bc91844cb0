"""A file of torch.save from any source, read in a process of its own: what `state_dicts.py` starts.

A pickle can be made to loop, and to ask for any amount of memory, though torch runs no code in it. So this process has
a limit on both, and where it ends early the parent says so. It imports nothing of this package.

The file is standard input. Standard output gets one byte, then what it stands for: `=` and the tensors as safetensors,
or `!` and what is wrong, in words.
"""

import os
import pickle
import signal
import struct
import sys
import warnings
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path

import safetensors.torch
import torch

if sys.platform != "win32":
    import resource

TENSORS, FAULT = b"=", b"!"
_SHOWN, _MAX_WORDS = 3, 80  # names, and characters of each
_MAX_TENSORS = 4096
_DAMAGED = (  # what torch.load raises on bytes that are not its own
    *(pickle.UnpicklingError, EOFError, RuntimeError, ValueError, LookupError, TypeError, AttributeError),
    *(AssertionError, ArithmeticError, ImportError, MemoryError, struct.error, OSError, RecursionError),
)


def main(seconds: float, most_bytes: int, memory_bytes: int) -> None:
    """Answer with the tensors of standard input.

    Args:
        seconds: of processor time.
        most_bytes: of all tensors together.
        memory_bytes: that may be taken beside what the libraries have taken.
    """
    torch.set_num_threads(1)
    _limit(seconds, memory_bytes)
    try:
        answer = TENSORS + safetensors.torch.save(_tensors(most_bytes))
    except _Fault as fault:
        answer = FAULT + str(fault).encode(errors="backslashreplace")
    except _DAMAGED as error:
        kind = type(error).__name__
        answer = FAULT + f"is damaged ({kind}), or holds more than tensors and their names, which is not read".encode()
    sys.stdout.buffer.write(answer)


class _Fault(Exception):  # noqa: N818 - what is wrong with the file, in words
    pass


def _tensors(most_bytes: int) -> dict[str, torch.Tensor]:
    with warnings.catch_warnings():  # of the pickle's protocol: it can be read, or is an error
        warnings.simplefilter("ignore")
        content = torch.load(sys.stdin.buffer, map_location="cpu", weights_only=True)
    if not isinstance(content, Mapping):
        raise _Fault(f"expected tensors by their names, a state dict, found {type(content).__name__}")
    others = list(islice(_not_weights(content), _SHOWN + 1))
    if others:
        more = " and others" if len(others) > _SHOWN else ""
        raise _Fault(f"expected names and tensors alone, found {', '.join(others[:_SHOWN])}{more}")
    size = sum(tensor.numel() * tensor.element_size() for tensor in content.values())
    if len(content) > _MAX_TENSORS or size > most_bytes:
        raise _Fault(f"holds {len(content):,} tensors of {size:,} bytes, more than {_MAX_TENSORS:,} of {most_bytes:,}")
    return {name: tensor.detach().resolve_conj().contiguous().clone() for name, tensor in content.items()}


def _not_weights(content: Mapping[object, object]) -> Iterator[str]:
    for name, value in content.items():
        if not _is_weight(name, value):
            shown = f"{name:.{_MAX_WORDS}}" if isinstance(name, str) else f"a name of type {type(name).__name__}"
            yield f"{shown} ({type(value).__name__})"


def _is_weight(name: object, value: object) -> bool:
    if not isinstance(name, str) or not isinstance(value, torch.Tensor):
        return False
    return value.layout == torch.strided and value.device.type == "cpu" and not value.is_quantized


def _limit(seconds: float, memory_bytes: int) -> None:
    """Have the kernel end this process at too much time, and refuse it memory beyond what it has."""
    if sys.platform == "win32":
        return
    signal.setitimer(signal.ITIMER_PROF, seconds)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        status = Path("/proc/self/status").read_text(encoding="ascii")
        taken = int(status.partition("VmData:")[2].split()[0]) * 1024
        resource.setrlimit(resource.RLIMIT_DATA, (taken + memory_bytes, taken + memory_bytes))


if __name__ == "__main__":
    main(float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
    sys.stdout.flush()
    os._exit(0)  # without what the libraries do at the end of a process, which takes a second
