"""What a mesh file holds, whatever its format."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

NO_COLOUR = -1  # in place of a colour's number: the face has none
MIXED_COLOURS = -2  # it has several


@dataclass(frozen=True)
class Material:
    """A material that faces of a mesh file have.

    Attributes:
        name: as the file has it.
        colour: linear RGB from 0 to 1; None where the file gives it none.
        missing_texture: the file that it names as its picture, and that is not there or no picture; else None.
    """

    name: str
    colour: tuple[float, float, float] | None = None
    missing_texture: str | None = None


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The triangles of a mesh file, where they stand in its scene, and what they are made of.

    Attributes:
        vertices: (V, 3) f8 in the file's unit and frame.
        triangles: (T, 3) indices of vertices, as they are wound in the file.
        material_of: (T,) indices of `materials`.
        materials: those that faces have; one without a name where the file has none.
        node_of: (T,) indices of `nodes`.
        nodes: the names of the scene's nodes that have faces; one where the file is no scene.
        colour_of: (T,) the sRGB of each face as red 65536 + green 256 + blue, from its own colour, its corners or its
            place in a texture; or NO_COLOUR, or MIXED_COLOURS.
    """

    vertices: Points
    triangles: Indices
    material_of: Indices
    materials: tuple[Material, ...]
    node_of: Indices
    nodes: tuple[str, ...]
    colour_of: npt.NDArray[np.int64]
