"""Mesh files of every format that is read: damaged bytes, words and headers, imported as objects."""

import json
import struct
from functools import partial

import numpy as np

from attack import laws
from attack.commands import outcome_of_command
from attack.damage import damage_json, damage_text, json_bytes, numbers_at
from attack.kinds import Attempt, Kind

_TEXTS = (".obj", ".off", "-ascii.stl", ".gltf")
_ODD_URIS = (
    *("../../outside/canary.h5", "/dev/zero", "/symsol-annot-attack", "http://127.0.0.1:1/x", "file:///etc/hostname"),
    *(
        "data:;base64,AAAA",
        "data:application/octet-stream;base64,!!",
        "",
        "\x1b[2J",
        "nul\0l",
        "%2e%2e/%2e%2e/outside/canary.h5",
    ),
)


def make_meshes(folder):
    """Write a box, a cup with a handle and a box with a texture in every format."""
    import trimesh
    from exported_meshes import cuboid, mesh_bytes, moved, mug, obj_lines, side_of, textured_box

    folder.mkdir()
    for name, solid in (("box", cuboid()), ("cup", moved(mug(8)))):
        for ending in ("stl", "ply", "off", "glb"):
            (folder / f"{name}.{ending}").write_bytes(mesh_bytes(solid, ending))
        (folder / f"{name}-ascii.stl").write_bytes(mesh_bytes(solid, "ascii"))
        (folder / f"{name}.obj").write_text(obj_lines(solid))
        vertices, triangles = solid
        exported: dict = trimesh.Trimesh(vertices, triangles, process=False).export(file_type="gltf")
        (folder / f"{name}.gltf").write_bytes(exported["model.gltf"])
        for file, data in exported.items():
            if file != "model.gltf":
                (folder / file).write_bytes(data)
    box = cuboid()
    (folder / "painted.obj").write_text(obj_lines(box, [f"side{k}" for k in side_of(box)]))
    (folder / "textured.glb").write_bytes(textured_box())
    (folder / "coloured.ply").write_bytes(mesh_bytes(box, "ply", face_colors=np.eye(3)[side_of(box) % 3]))


class Meshes(Kind):
    """Mesh files: OBJ, STL, PLY, OFF, GLB and glTF."""

    name, cases = "mesh files", 500
    modules, bases = (
        ("objects.importing.importing", "objects.importing.object_writing", "objects.spec", "cli"),
        ("meshes",),
    )

    def __init__(self, root):
        everything = {path.name: path.read_bytes() for path in sorted((root / "meshes").iterdir())}
        self._beside = {name: data for name, data in everything.items() if name.endswith(".bin")}
        self._files = {name: data for name, data in everything.items() if name not in self._beside}
        import trimesh  # noqa: F401 - so that no attempt has to

    def attempt(self, place, number, rng):
        name = sorted(self._files)[rng.integers(len(self._files))]
        changes = _changes_for(name)
        content, done = self._files[name], [name]
        for _ in range(rng.choice([1, 1, 2])):
            change = changes[rng.integers(len(changes))]
            content = change(content, rng)
            done.append(change.__name__)
        if rng.random() < 0.05:  # as another format
            name = f"thing.{('stl', 'ply', 'off', 'glb', 'gltf', 'obj')[rng.integers(6)]}"
            done.append(f"called {name}")
        path = place.case / name
        for other, data in self._beside.items():
            (place.case / other).write_bytes(flipped(data, rng) if rng.random() < 0.2 else data)
        path.write_bytes(content)
        if rng.random() < 0.2:
            return Attempt([*done, "symmetries"], lambda: outcome_of_command("symmetries", path, "--json"))
        return Attempt(done, partial(self._imported, path, place.out / "thing"))

    @staticmethod
    def _imported(path, folder):
        from symsol_annot.objects.importing.importing import ImportOptions, import_mesh
        from symsol_annot.objects.importing.object_writing import object_files, written_object

        imported = import_mesh(path, "thing", ImportOptions())
        with written_object(folder, object_files(imported.draft)) as (_, spec):
            if not np.isfinite(spec.mesh.vertices).all():
                raise laws.SilentError("a vertex that is nowhere")
            laws.check_group(spec.symmetry_group)
            laws.check_group(spec.stabiliser)
        return "right"


def _changes_for(name):
    changes = [flipped, cut, number, doubled]
    if name.endswith(_TEXTS):
        changes += [words, words, words]
    if name.endswith(".ply"):
        changes += [ply_header, ply_header]
    if name.endswith((".glb", ".gltf")):
        changes += [gltf_json, gltf_json, gltf_uri]
    if name.endswith(".stl") and not name.endswith("-ascii.stl"):
        changes += [stl_count, values]
    return changes


def flipped(content, rng):
    data = bytearray(content)
    end = min(len(data), 200) if rng.random() < 0.4 else len(data)
    for at in rng.integers(0, max(1, end), rng.integers(1, 6)):
        if data:
            data[at] ^= 1 << int(rng.integers(8))
    return bytes(data)


def cut(content, rng):
    return content[: rng.integers(len(content) + 1)]


def number(content, rng):
    """A number at which counts and sizes break."""
    size = int(rng.choice([1, 2, 4, 8]))
    at = int(rng.integers(max(1, min(len(content), 400) if rng.random() < 0.5 else len(content))))
    return content[:at] + numbers_at(rng, size) + content[at + size :]


def doubled(content, rng):
    at, length = int(rng.integers(len(content) + 1)), int(rng.integers(1, 300))
    return content[:at] + content[at : at + length] * int(rng.choice([2, 50])) + content[at:]


def words(content, rng):
    text, _ = damage_text(content.decode("latin-1"), rng)
    return text.encode("utf-8", errors="surrogatepass")


def ply_header(content, rng):
    """A header that says other counts, types or names."""
    head, end, body = content.partition(b"end_header\n")
    lines = head.split(b"\n")
    at = int(rng.integers(len(lines)))
    parts = lines[at].split(b" ")
    odd = (
        b"-1",
        b"0",
        b"999999999999",
        b"1e9",
        b"list",
        b"uchar",
        b"double",
        b"float128",
        b"face",
        b"vertex",
        b"",
        b"x" * 9999,
    )
    parts[rng.integers(len(parts))] = odd[rng.integers(len(odd))]
    lines[at] = b" ".join(parts)
    if rng.random() < 0.2:
        lines.insert(at, lines[rng.integers(len(lines))])
    return b"\n".join(lines) + end + body


def stl_count(content, rng):
    return content[:80] + numbers_at(rng, 4) + content[84:]


def values(content, rng):
    """Coordinates that are none, or that no float holds."""
    at = 84 + 4 * int(rng.integers(max(1, (len(content) - 84) // 4)))
    odd = (float("nan"), float("inf"), 3e38, -3e38, 1e-45, 0.0, 1e20)
    return content[:at] + struct.pack("<f", odd[rng.integers(len(odd))]) + content[at + 4 :]


def gltf_json(content, rng):
    return _with_json(content, lambda document: damage_json(document, rng))


def gltf_uri(content, rng):
    """Buffers and pictures that lie elsewhere, or say another size."""

    def change(document):
        uri = _ODD_URIS[rng.integers(len(_ODD_URIS))]
        for buffer in document.get("buffers", []):
            if isinstance(buffer, dict):
                buffer["uri"] = uri
        document.setdefault("images", [{}])
        for image in document["images"] if isinstance(document["images"], list) else ():
            if isinstance(image, dict) and rng.random() < 0.5:
                image["uri"] = uri

    return _with_json(content, change)


def _with_json(content, change):
    """Return a glTF, or a GLB with lengths that are right, whose JSON was changed."""
    is_glb = content[:4] == b"glTF"
    try:
        start = 20 if is_glb else 0
        length = struct.unpack("<I", content[12:16])[0] if is_glb else len(content)
        document = json.loads(content[start : start + length])
    except (ValueError, struct.error, RecursionError):
        return content
    if not isinstance(document, dict):
        return content
    change(document)
    text = json_bytes(document)
    if not is_glb:
        return text
    text += b" " * (-len(text) % 4)
    rest = content[start + length :]
    return b"glTF" + struct.pack("<III", 2, 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest
