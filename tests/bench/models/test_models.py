"""The public module of models: the examples of its page run, and scoring does without it."""

import re
import subprocess
import sys
from pathlib import Path

from reference_models import pictures, rotations

from symsol_annot.bench.models.weights.state_dicts import read_weights

ROOT = Path(__file__).resolve().parents[3]


def test_scoring_and_writing_predictions_load_no_torch():
    code = (
        "import sys, symsol_annot.bench.scoring.scoring, symsol_annot.bench.submission, "
        "symsol_annot.bench.scoring.reference, symsol_annot.plotting.contact_sheet\n"
        "print([name for name in ('torch', 'roma', 'safetensors') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_examples_of_the_models_page_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"images": pictures(2), "R_gt": rotations(2), "negatives": rotations(2 * 5).reshape(2, 5, 3, 3)}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/models.md").read_text(), flags=re.DOTALL)
    for block in blocks:
        exec(block.replace('pretrained="imagenet"', "pretrained=None"), names)
    assert names["hypotheses"].shape == (2, 30, 3, 3)
    assert names["probability"].shape == (2, 4608)
    assert set(read_weights(tmp_path / "network.safetensors")) == set(names["network"].state_dict())
