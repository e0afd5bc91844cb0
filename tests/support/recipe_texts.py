"""Texts of recipes: a good one, changed ones, and what a bad one is refused with."""

import pytest

from symsol_annot.bench.models.recipe import parse_recipe
from symsol_annot.errors import SettingsError

GOOD = """
title = "a test"
model = "hypotheses"
start = "random"
hypotheses = 4
meta_loss = "ewta"
embedded_loss = "von-mises"
batch_size = 8
epochs = 10
epochs_to_one = 5
learning_rates = [1e-3, 1e-4]
milestones = [8]
"""


def changed(text, **keys):
    """The recipe with keys replaced, added, or where None left out."""
    lines = [line for line in text.splitlines() if line.split(" = ")[0] not in keys]
    return "\n".join([*lines, *(f"{key} = {value}" for key, value in keys.items() if value is not None)])


def refusal(text):
    with pytest.raises(SettingsError) as caught:
        parse_recipe(text, "mine.toml")
    assert str(caught.value).startswith("mine.toml: ")
    return str(caught.value)
