"""The files that a mesh file names: materials, textures, buffers. They are read beside it or below, nowhere else."""

from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from symsol_annot.system.reading import read_bytes

MAX_NEIGHBOUR_BYTES = 2**28


class NeighbouringFiles:
    """Reads files in the folder of a mesh file, by the names that it gives them.

    Args:
        folder: of the mesh file.

    Attributes:
        missing: the names that were asked for and are not there.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.missing: list[str] = []

    def read(self, name: str) -> bytes | None:
        """Return a file's bytes; None where it is not there, or not below the folder, and then it is `missing`."""
        for candidate in (name, unquote(name)):
            inside = PurePosixPath(candidate.replace("\\", "/"))
            if inside.is_absolute() or ".." in inside.parts or ":" in candidate or "\0" in candidate:
                continue
            try:
                return read_bytes(self._folder / inside, MAX_NEIGHBOUR_BYTES)
            except OSError:
                continue
        self.missing.append(name)
        return None

    def get(self, name: str) -> bytes:
        """Return a file's bytes, as trimesh asks for them.

        Raises:
            FileNotFoundError: there is none.
        """
        data = self.read(name)
        if data is None:
            raise FileNotFoundError(f"{name} is not beside the mesh file")
        return data

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)
