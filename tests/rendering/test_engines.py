"""One table of engines: whoever asks about an engine asks the table, so that a new one is an entry and nothing else."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from symsol_annot_cli.render import render

from symsol_annot.annotation.visibility import vertex_shift
from symsol_annot.errors import SettingsError
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.engines import DEFAULT_ENGINE, ENGINES, engine_named, engines_without_opengl
from symsol_annot.rendering.settings import RenderSettings

CONVENTIONS = Path(__file__).parents[2] / "docs" / "conventions.md"
ADD_AN_ENGINE = """
import json
import os
import sys
from dataclasses import replace

from symsol_annot.rendering.engines import ENGINES

answers = os.fdopen(os.dup(1), "w")
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Blender talks
ENGINES["twin"] = replace(ENGINES["workbench"], name="twin", vertex_shift=0.25)

import numpy as np
from symsol_annot_cli.render import render

from symsol_annot.annotation.visibility import vertex_shift
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering import doctor
from symsol_annot.rendering.blender_process import open_blender
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import Scene
from symsol_annot.rendering.settings import RenderSettings

doctor._engine = lambda name: name
doctor.check_blender_installed = lambda: None
tried = list(doctor.examine(doctor.Path(".")))[3:]
choices = next(option for option in render.params if option.name == "engine").type.choices
settings = RenderSettings.from_dict(RenderSettings("twin").to_dict())
shift = vertex_shift(Camera.filling(32), settings)
views = {}
for name in ("workbench", "twin"):
    renderer = open_blender(Scene(load_object("tetX").mesh, Camera.filling(32), RenderSettings(name)))
    view = renderer.render(np.eye(3))
    views[name] = [view.rgb.tolist(), view.segmentation.tolist(), view.marking_pixels, sorted(renderer.versions)]
answer = {"tried": tried, "choices": list(choices), "shift": shift, "is_alike": views["workbench"] == views["twin"]}
print(json.dumps(answer), file=answers, flush=True)
os._exit(0)
"""


@pytest.mark.blender
def test_an_engine_added_to_the_table_draws_and_is_known_everywhere():
    """Settings, the bounds' margin, the command's choices, the doctor and Blender's set-up follow it."""
    paths = os.pathsep.join(filter(None, sys.path))
    environment = {**os.environ, "PYTHONPATH": paths, "LP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", ADD_AN_ENGINE], env=environment, capture_output=True, text=True, timeout=300, check=True
    )
    found = json.loads(done.stdout)
    assert found["tried"] == ["opengl", "workbench", "cycles", "twin"]
    assert found["choices"] == [*ENGINES, "twin"]
    assert 0.25 <= found["shift"] < 0.251
    assert found["is_alike"]


def test_the_table_is_keyed_by_name_and_holds_the_default():
    assert all(engine.name == name for name, engine in ENGINES.items())
    assert DEFAULT_ENGINE in ENGINES
    assert RenderSettings().engine == DEFAULT_ENGINE


def test_the_commands_choices_are_the_table():
    option = next(option for option in render.params if option.name == "engine")
    assert list(option.type.choices) == list(ENGINES)
    assert option.default == DEFAULT_ENGINE


def test_every_engine_has_a_margin_below_half_a_lattice_point_and_stands_in_the_conventions():
    text = CONVENTIONS.read_text(encoding="utf-8")
    for name in ENGINES:
        assert 0 < vertex_shift(Camera.filling(224), RenderSettings(name)) < 0.5
        assert f"`{name}`" in text


@pytest.mark.parametrize("name", ["povray", "Workbench", "", None, 1, [], {}])
def test_an_unknown_engine_is_refused_with_the_ones_there_are(name):
    for refuse in (engine_named, RenderSettings):
        with pytest.raises(SettingsError, match="expected one of opengl, workbench, cycles, eevee, found"):
            refuse(name)


def test_some_engine_draws_where_there_is_no_opengl():
    assert engines_without_opengl() == ["cycles"]
