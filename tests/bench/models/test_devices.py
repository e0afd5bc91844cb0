"""What fits into a device's memory, and in which precision a network runs on it."""

import pytest
import torch

from symsol_annot.bench.models import devices
from symsol_annot.bench.models.devices import (
    has_bfloat16,
    largest_that_fits,
    products_precision,
    takes_bfloat16,
)
from symsol_annot.errors import SettingsError

CPU = torch.device("cpu")


@pytest.fixture
def cpu_says(tmp_path, monkeypatch):
    """Have the processor's flags be others for a test."""

    def say(flags):
        (tmp_path / "cpuinfo").write_text(f"processor : 0\nflags : {flags}\n")
        monkeypatch.setattr(devices, "_CPUINFO", tmp_path / "cpuinfo")
        devices._cpu_words.cache_clear()

    yield say
    devices._cpu_words.cache_clear()


def test_halving_ends_with_none_where_not_even_one_fits():
    def never(_):
        raise torch.cuda.OutOfMemoryError

    def hungry(batch_size):
        if batch_size > 20:
            raise torch.cuda.OutOfMemoryError
        return f"{batch_size} images"

    assert largest_that_fits(never, 64) is None
    assert largest_that_fits(hungry, 0) is None
    assert largest_that_fits(hungry, 64) == (16, "16 images")
    assert largest_that_fits(hungry, 7) == (7, "7 images")


@pytest.mark.parametrize(
    ("flags", "has"), [("avx2 avx512_bf16 sse", True), ("amx_bf16", True), ("avx2 avx512f", False)]
)
def test_a_processor_has_bfloat16_where_it_says_so(cpu_says, flags, has):
    cpu_says(flags)
    assert has_bfloat16(CPU) == has


def test_a_system_that_does_not_tell_has_none(monkeypatch, tmp_path, cpu_says):
    cpu_says("avx512_bf16")
    monkeypatch.setattr(devices, "_CPUINFO", tmp_path / "nowhere")
    devices._cpu_words.cache_clear()
    assert not has_bfloat16(CPU)


def test_auto_takes_bfloat16_of_images_whose_gradients_are_right(cpu_says):
    cpu_says("avx512_bf16")
    found = {
        (precision, side): takes_bfloat16(CPU, precision, side)
        for precision in ("auto", "float32")
        for side in (16, 17)
    }
    assert found == {("auto", 16): False, ("auto", 17): True, ("float32", 16): False, ("float32", 17): False}
    cpu_says("avx2")
    assert not takes_bfloat16(CPU, "auto", 224)
    assert takes_bfloat16(CPU, "bfloat16", 224)  # which a training refuses before


@pytest.mark.parametrize(
    ("flags", "asked", "found"),
    [
        ("avx2", "float32", "float32"),
        ("avx2", "auto", "float32"),
        ("amx_bf16", "float32", "float32"),
        ("amx_bf16", "auto", "bfloat16"),
        ("amx_bf16", "bfloat16", "bfloat16"),
    ],
)
def test_rotations_are_scored_in_bfloat16_where_that_is_asked_for_and_fast(cpu_says, flags, asked, found):
    cpu_says(flags)
    assert products_precision(CPU, asked) == found


def test_bfloat16_is_refused_where_products_are_not_faster_in_it(cpu_says):
    cpu_says("avx2")
    with pytest.raises(SettingsError, match=r"bfloat16 is for CPUs that compute in it, .* take --precision float32"):
        products_precision(CPU, "bfloat16")
