"""Fixtures of objects: a folder that is written, and the message that it is refused with."""

import pytest
from object_folders import MESH, TOML

from symsol_annot.errors import ObjectError
from symsol_annot.objects.spec import read_object


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
