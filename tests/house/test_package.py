"""What the packages show to the outside: names, imports, docstrings, exceptions, versions."""

import ast
import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
from importlib import resources
from importlib.metadata import version
from pathlib import Path

import pytest

import symsol_annot
from symsol_annot import errors

PROJECT = Path(__file__).parents[2]
PACKAGES = ("symsol_annot", "symsol_annot_cli", "symsol_annot_assets")
SOURCES = sorted(Path(symsol_annot.__file__).parent.rglob("*.py"))
BASE = {"symsol_annot", "numpy", "scipy", "h5py", "zlib_ng"}
COMMAND_LINE = BASE | {"symsol_annot_cli", "symsol_annot_assets", "click", "tqdm", "healpix", "chealpix"}

LOADED_BY_IMPORT = """
import json, sys
before = set(sys.modules)
import {module}
after = {{name: getattr(sys.modules[name], "__file__", None) for name in set(sys.modules) - before}}
print(json.dumps(after))
"""


def modules_loaded_by(module):
    """Name to file of the modules that an import loads in a fresh process that knows only the standard library."""
    code = LOADED_BY_IMPORT.format(module=module)
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return json.loads(done.stdout)


def distributions(modules):
    """The top-level names outside the standard library; what a compiled extension registers has no file of its own."""
    roots = {name.partition(".")[0]: file for name, file in modules.items() if file is not None}
    standard = sys.stdlib_module_names | {name for name in roots if name.startswith("_sysconfigdata")}
    return {root for root in roots if root not in standard}


def test_the_public_names_are_these():
    names = {"Dataset", "Sample", "SymsolError", "__version__", "load", "load_sample", "score", "shuffled_order"}
    assert set(symsol_annot.__all__) == names
    assert len(symsol_annot.__all__) == len(set(symsol_annot.__all__))
    assert all(hasattr(symsol_annot, name) for name in symsol_annot.__all__)


@pytest.mark.parametrize(("module", "allowed"), [("symsol_annot", BASE), ("symsol_annot_cli.main", COMMAND_LINE)])
def test_an_import_loads_nothing_but_what_is_on_its_list(module, allowed):
    modules = modules_loaded_by(module)
    assert module in modules
    extensions = {"cython", "Cython", "_cyutility", "_csparsetools", "cython_runtime"}  # of scipy and h5py
    assert distributions(modules) - extensions <= allowed


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_are_marked_as_typed(package):
    assert resources.files(package).joinpath("py.typed").is_file()


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_everything_public_has_a_docstring(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"{path.name}: the module"
    assert [name for name, node in public_definitions(tree) if not ast.get_docstring(node)] == []


def public_definitions(tree, prefix=""):
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_") and not is_overload(node):
            yield f"{prefix}{node.name}", node
            if isinstance(node, ast.ClassDef):
                yield from public_definitions(node, f"{node.name}.")


def is_overload(node):
    return any(isinstance(decorator, ast.Name) and decorator.id == "overload" for decorator in node.decorator_list)


def is_exception(member):
    return inspect.isclass(member) and issubclass(member, BaseException)


def test_the_drawn_tree_of_exceptions_is_the_one_in_the_code():
    drawn, branch = {}, {}
    for line in errors.__doc__.splitlines():
        text = line.lstrip(" │├└─")
        name = text.partition(" ")[0]
        if name.endswith("Error"):
            depth = (len(line) - len(text)) // 4
            branch[depth] = name
            drawn[name] = branch.get(depth - 1, "Exception")
    assert drawn == {cls.__name__: cls.__bases__[0].__name__ for _, cls in inspect.getmembers(errors, is_exception)}
    assert all(issubclass(getattr(errors, name), errors.SymsolError) for name in drawn)


def test_no_other_module_defines_a_public_exception():
    names = [found.name for found in pkgutil.walk_packages(symsol_annot.__path__, "symsol_annot.")]
    modules = [
        importlib.import_module(name) for name in names if "rendering.blender" not in name.removesuffix("_process")
    ]
    assert len(modules) > 15
    stray = [
        f"{module.__name__}.{name}"
        for module in modules
        for name, cls in inspect.getmembers(module, is_exception)
        if cls.__module__ == module.__name__ != "symsol_annot.errors" and not name.startswith("_")
    ]
    assert stray == []


def test_package_command_installation_and_citation_state_one_version():
    citation = re.findall(
        r"^version: (.+)$", (PROJECT / "CITATION.cff").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    code = "from symsol_annot_cli.main import main; main()"
    done = subprocess.run([sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=False)
    assert done.stdout.split()[-1] == symsol_annot.__version__ == version("symsol-annot")
    assert citation == [symsol_annot.__version__]
    assert done.returncode == 0
