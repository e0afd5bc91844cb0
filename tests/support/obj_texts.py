"""OBJ files of small bodies, as text."""

H = 1 / 3**0.5
CORNERS = [(H, H, H), (H, -H, -H), (-H, H, -H), (-H, -H, H)]
FACES = ["f 2 4 3", "f 1 3 4", "f 1 4 2", "f 1 2 3"]  # face k is opposite corner k
TETRAHEDRON = "\n".join([*(f"v {x!r} {y!r} {z!r}" for x, y, z in CORNERS), *FACES]) + "\n"
CUBE = f"""\
# a cube, as exporters write it
mtllib cube.mtl
o Cube

v -{H} -{H} -{H}
v {H} -{H} -{H}   # a comment behind a statement
v {H} {H} -{H}
v -{H} {H} -{H}
v -{H} -{H} {H}
v {H} -{H} {H}
v {H} {H} {H}
v -{H} {H} {H}
vt 0.5 0.5
vn 0 0 7
vn 1 1 1
s off
g sides
f 1/1 4/1 3/1 2/1
f 1 2 6 5
f 2/1/2 3 7//2 6
usemtl marking
f 5//1 6//1 7//1 8//1
usemtl body
f 3 4 8 7
f 4 1 5 8
"""


def replaced(text, old, new):
    """Replace one statement; also return the number of its line."""
    lines = text.splitlines()
    (index,) = [i for i, line in enumerate(lines) if line == old]
    lines[index] = new
    return "\n".join(lines) + "\n", index + 1
