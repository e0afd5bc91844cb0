"""The release: what wheel and sdist hold, what the wheel can do in an empty environment, and a project that uses it."""

import json
import re
import tarfile
import zipfile
from pathlib import Path

import pytest
from environments import PROJECT, Environment, build, project_copy
from installed import NEEDS, check_base, check_refusal

import symsol_annot
from symsol_annot.bench.predictions.truth import truth_of
from symsol_annot.bench.scoring import reference
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.sets.sample_set import sample_folder

EXAMPLE = PROJECT / "examples" / "train_small"
BASE_REQUIREMENTS = ("numpy", "scipy", "healpix", "h5py", "zlib-ng", "pillow", "click", "tqdm")


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """The sdist, and the wheel that was built from it."""
    return build(project_copy(tmp_path_factory.mktemp("project")), tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="session")
def base(built, tmp_path_factory):
    """An empty environment, and the wheel installed into it from the package index."""
    environment = Environment(tmp_path_factory.mktemp("base") / "env")
    environment.pip("install", "--quiet", "--no-compile", "--constraint", PROJECT / "constraints.txt", built[-1])
    return environment


def files_of(project, *folders):
    return {
        path.relative_to(project).as_posix()
        for folder in folders
        for path in (project / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_wheel_holds_every_file_of_the_packages_and_nothing_else(built):
    names = {"symsol_annot": "symsol_annot", "cli": "symsol_annot_cli", "blender_assets": "symsol_annot_assets"}
    expected = {re.sub(r"^\w+", lambda m: names[m[0]], path) for path in files_of(PROJECT, *names)}
    with zipfile.ZipFile(built[-1]) as wheel:
        inside = {name for name in wheel.namelist() if ".dist-info/" not in name}
        assert inside == expected
        assert {f"{name}/py.typed" for name in names.values()} <= inside
        for path in files_of(sample_folder(), "."):
            assert wheel.read(f"symsol_annot/sample_data/{path}") == (sample_folder() / path).read_bytes()


def test_wheel_and_sdist_have_the_version_and_stay_small(built):
    sdist, wheel = built
    version = symsol_annot.__version__
    assert (sdist.name, wheel.name) == (f"symsol_annot-{version}.tar.gz", f"symsol_annot-{version}-py3-none-any.whl")
    assert max(path.stat().st_size for path in built) < 5e6


def test_the_sdist_has_changelog_and_citation_and_no_tests(built):
    with tarfile.open(built[0]) as sdist:
        names = [Path(*Path(name).parts[1:]).as_posix() for name in sdist.getnames()]
    assert {"CHANGELOG.md", "CITATION.cff", "LICENSE"} <= set(names)
    assert not [name for name in names if name.startswith(("tests", "docs", "examples"))]


def test_a_base_installation_brings_these_and_no_more(base):
    assert base.distributions() == {"symsol-annot", *BASE_REQUIREMENTS}
    base.pip("check")


def test_a_base_installation_loads_verifies_and_scores(base, tmp_path):
    check_base(base, tmp_path)


def test_the_code_of_the_install_page_runs_in_it(base):
    code = re.search(r"```python\n(.*?)```", (PROJECT / "docs" / "install.md").read_text(), flags=re.DOTALL)[1]
    assert base.run("python", "-c", code).stdout.strip().endswith("sample_data/cylO")


@pytest.mark.parametrize(("extra", "words"), NEEDS, ids=lambda value: value[0] if isinstance(value, list) else value)
def test_a_command_without_its_extra_says_in_one_line_which_to_install(base, extra, words, tmp_path):
    check_refusal(base, extra, words, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_dataset_for_torch_says_the_same(base):
    ask = "try: import symsol_annot.sets.torch\nexcept ImportError as error: print(error)"
    assert "pip install 'symsol-annot[bench]'" in base.run("python", "-c", ask).stdout


def test_the_example_project_trains_on_the_wheel_alone_and_beats_chance(built, tmp_path):
    """Its environment holds the wheel, the project's own, and links to this one's torch and base requirements."""
    environment = Environment(tmp_path / "env")
    environment.borrow("torch", *BASE_REQUIREMENTS)
    project = project_wheel(tmp_path)
    environment.pip("install", "--quiet", "--no-deps", "--no-compile", "--no-index", built[-1], project)
    environment.pip("check")
    work = tmp_path / "work"
    work.mkdir()
    said = environment.run("train-small", "--steps", "100", cwd=work).stdout
    command = re.search(r"symsol-annot (score .* --data (.*))$", said, flags=re.MULTILINE)
    assert Path(command[2]).is_relative_to(environment.packages)
    environment.run("symsol-annot", *command[1].split(), "--json", "scores.json", cwd=work)
    figures = json.loads((work / "scores.json").read_text())["objects"]["tetX"]["hypotheses"]["all"]
    for name, chance in chance_figures(work).items():
        assert figures[name]["value"] < 0.75 * chance, name


def project_wheel(folder):
    source = folder / "train_small"
    source.mkdir()
    for path in EXAMPLE.iterdir():
        if path.is_file():
            (source / path.name).write_bytes(path.read_bytes())
    return build(source, folder / "dist", "--wheel")[-1]


def chance_figures(folder):
    """What 30 random rotations per image score on the same images; the example has 16."""
    test = symsol_annot.load_sample("tetX")
    reference.uniform(folder / "uniform.h5", test, truth_of(test), 1)
    figures = score_file(folder / "uniform.h5", test.folder).tracks["hypotheses"].figures["all"]
    return {name: figures[name].value for name in ("recall_mean_error_rad", "precision_mean_error_rad")}
