"""Fixtures of objects: a folder that is written, and the message that it is refused with."""

import pytest
from asset_geometry import GROUPS
from object_folders import MESH, TOML

from symsol_annot.errors import ObjectError
from symsol_annot.objects.obj_file import read_mesh
from symsol_annot.objects.spec import load_object, read_object


@pytest.fixture
def write(tmp_path):
    """Write an object's folder and return it."""

    def write_object(toml=TOML, mesh=MESH):
        folder = tmp_path / "object"
        folder.mkdir(exist_ok=True)
        (folder / "object.toml").write_bytes(toml if isinstance(toml, bytes) else toml.encode())
        (folder / "mesh.obj").write_bytes(mesh if isinstance(mesh, bytes) else mesh.encode())
        return folder

    return write_object


@pytest.fixture
def fault_of(write):
    """Return the message that an object.toml is refused with, and the path that it must name."""

    def message(toml, mesh=MESH):
        folder = write(toml, mesh)
        with pytest.raises(ObjectError) as caught:
            read_object(folder)
        return str(caught.value), str(folder / "object.toml")

    return message


@pytest.fixture
def read_obj(tmp_path):
    """Read a text as a mesh.obj."""

    def read_text(text):
        path = tmp_path / "mesh.obj"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_mesh(path)

    return read_text


@pytest.fixture
def obj_fault_of(read_obj, tmp_path):
    """Return the message that a text is refused with, less the file's path, which it must start with."""

    def message(text):
        with pytest.raises(ObjectError) as caught:
            read_obj(text)
        path, where_and_what = str(tmp_path / "mesh.obj"), str(caught.value)
        assert where_and_what.startswith(path)
        return where_and_what.removeprefix(path).lstrip(":, ")

    return message


@pytest.fixture(scope="session")
def meshes():
    """The meshes of the built-in objects, by name."""
    return {name: load_object(name).mesh for name in GROUPS}
