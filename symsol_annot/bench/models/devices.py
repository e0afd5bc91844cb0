"""What a network runs on: which device, in which precision, and how many images at once its memory holds."""

import contextlib
import platform
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from symsol_annot.bench.models.recipe_keys import AUTO, BFLOAT16, FLOAT32, LEAST_BFLOAT16_SIZE
from symsol_annot.errors import ModelError, SettingsError

T = TypeVar("T")
Model = TypeVar("Model", bound=nn.Module)

_MEMINFO, _CPUINFO = Path("/proc/meminfo"), Path("/proc/cpuinfo")
_BFLOAT16_FLAGS = frozenset({"avx512_bf16", "amx_bf16"})
_CGROUP = Path("/sys/fs/cgroup")


def choose_device(name: str) -> torch.device:
    """Return a device by torch's name; "auto" is a GPU where there is one.

    Raises:
        SettingsError: there is no such device here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).partition("\n")[0]
        raise SettingsError(f"device: there is no {name!r} here ({reason}); auto and cpu always work") from None
    return device


def hardware(device: torch.device) -> str:
    """Say in words what a device is: a GPU's name, or the processor's and how many threads compute on it."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    name = platform.machine()
    with contextlib.suppress(OSError, StopIteration):
        lines = _CPUINFO.read_text().splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    threads = torch.get_num_threads()
    return f"{name}, {threads} thread{'s' if threads > 1 else ''}"


def has_bfloat16(device: torch.device) -> bool:
    """Tell whether a device computes in bfloat16 by itself, so that it is faster there."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return device.type == "cpu" and not _BFLOAT16_FLAGS.isdisjoint(_cpu_words())


@lru_cache(maxsize=1)
def _cpu_words() -> frozenset[str]:
    """Return all words that the system says of its processor; none where it says nothing (all but Linux)."""
    with contextlib.suppress(OSError):
        return frozenset(_CPUINFO.read_text().split())
    return frozenset()


def takes_bfloat16(device: torch.device, precision: str, side: int) -> bool:
    """Tell whether a network is trained in bfloat16: its backbone, and what scores rotations of a classifier's kind.

    Args:
        device: that it is trained on.
        precision: the recipe's key.
        side: of its input, in pixels.
    """
    if precision != AUTO:
        return precision == BFLOAT16
    return has_bfloat16(device) and (device.type != "cpu" or side >= LEAST_BFLOAT16_SIZE)


def laid_out_for(device: torch.device, model: Model) -> Model:
    """Move a model to a device, on a GPU with an image's channels side by side, as its convolutions want them.

    On a CPU that is 7% faster in the network and takes Adam three times as long, so it is left.
    """
    if device.type != "cuda":
        return model.to(device)
    return model.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]


@contextlib.contextmanager
def training_precision(images: Tensor, precision: str) -> Iterator[None]:
    """Run what is inside in bfloat16 where `takes_bfloat16`, of images (B, H, W, 3) on their device."""
    device = images.device
    with torch.autocast(device.type, torch.bfloat16, enabled=takes_bfloat16(device, precision, images.shape[1])):
        yield


@contextlib.contextmanager
def full_precision(*, benchmark: bool = False) -> Iterator[None]:
    """Run what is inside in float32 where it says float32: on a GPU convolutions would take TF32's 10 bits for it.

    Args:
        benchmark: whether each new shape's fastest convolution is found by trying, once.
    """
    with torch.backends.cudnn.flags(enabled=True, benchmark=benchmark, allow_tf32=False):
        yield


def products_precision(device: torch.device, precision: str) -> str:
    """Return in which precision a device multiplies when it scores rotations: "float32" or "bfloat16".

    Args:
        device: that a model is asked on.
        precision: "float32", "bfloat16", or "auto", bfloat16 on a CPU that computes in it.

    Raises:
        SettingsError: bfloat16 on a GPU, or on a CPU that does not compute in it.
    """
    has = device.type == "cpu" and has_bfloat16(device)
    if precision == BFLOAT16 and not has:
        raise SettingsError(
            f"precision: bfloat16 is for CPUs that compute in it, which {hardware(device)} does not; "
            "take --precision float32"
        )
    return BFLOAT16 if has and precision != FLOAT32 else FLOAT32


def free_bytes(device: torch.device) -> int:
    """Return how much memory of a device is free, as far as that can be told."""
    if device.type == "cuda":
        return int(torch.cuda.mem_get_info(device)[0])
    with contextlib.suppress(OSError, ValueError, IndexError, StopIteration):
        line = next(line for line in _MEMINFO.read_text().splitlines() if line.startswith("MemAvailable:"))
        return min(int(line.split()[1]) * 1024, _free_in_cgroup())
    return 0


def largest_that_fits(attempt: Callable[[int], T], batch_size: int) -> tuple[int, T] | None:
    """Return the largest of batch_size, batch_size / 2, .. that an attempt has memory for, and what the attempt gave.

    Returns:
        None where not even 1 fits.
    """
    while batch_size > 0:
        try:
            return batch_size, attempt(batch_size)
        except torch.cuda.OutOfMemoryError:
            pass  # what the attempt held is let go only outside of this block
        torch.cuda.empty_cache()
        batch_size //= 2
    return None


def as_memory_allows(ask: Callable[[int], T], batch_size: int) -> T:
    """Return what a model says when it is asked in the largest batches, up to a size, that memory holds.

    Raises:
        ModelError: memory does not hold a single image.
    """
    fitting = largest_that_fits(ask, batch_size)
    if fitting is None:
        raise ModelError(
            "the GPU's memory does not hold the network and a single image; end what else uses it, or take --device cpu"
        )
    return fitting[1]


def _free_in_cgroup() -> int:
    """Return what a container's limit leaves; without one, more than any machine has."""
    with contextlib.suppress(OSError, ValueError):
        return int((_CGROUP / "memory.max").read_text()) - int((_CGROUP / "memory.current").read_text())
    return 2**62
