"""A plain Renderer on a caster of rays against triangles, for objects of any parts and few triangles."""

import numpy as np

from symsol_annot.rendering.renderer import LabelWindow, LitWindow, View
from symsol_annot.rendering.windows import Window

N = 2  # points of the lattice per pixel and axis


class MeshRenderer:
    """Draws an object's parts in their colours, lit from the camera with flat faces; counts what it is asked for."""

    def __init__(self, spec, camera):
        self.spec, self.camera, self.drawn, self.counted = spec, camera, 0, 0
        self._triangles = spec.mesh.vertices[spec.mesh.triangles]
        self._colours = np.array([part.colour for part in spec.parts])

    @property
    def versions(self):
        return {"renderer": "numpy, of meshes"}

    def ids_and_rgb(self, R):
        """Ids (n H + 1, n W + 1) and sRGB levels (.., 3) at the points of the lattice, each cast as a ray."""
        camera, width, height = self.camera, N * self.camera.width + 1, N * self.camera.height + 1
        x, y = np.meshgrid(np.arange(width) / N, np.arange(height) / N)
        directions = np.stack([x - camera.width / 2, y - camera.height / 2], -1).reshape(-1, 2) / camera.focal_px
        rays = np.column_stack([directions, np.ones(len(directions))])
        corners = self._triangles @ R.T + np.array([0, 0, camera.distance])
        depth, hit = np.full(len(rays), np.inf), np.zeros(len(rays), int) - 1
        for number, (a, b, c) in enumerate(corners):
            normal = np.cross(b - a, c - a)
            if normal @ a >= 0:  # a back face
                continue
            sides = [np.cross(p, q) for p, q in ((a, b), (b, c), (c, a))]
            inside = np.all([rays @ side <= 0 for side in sides], axis=0)
            with np.errstate(divide="ignore"):
                far = (normal @ a) / (rays @ normal)
            nearer = inside & (far < depth)
            depth[nearer], hit[nearer] = far[nearer], number
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        light = 0.04 + 0.96 * np.maximum(0, -normals[:, 2] / np.linalg.norm(normals, axis=1))
        part = self.spec.mesh.part_ids.astype(int)
        linear = np.clip(light[:, None] * self._colours[part - 1], 0, 1)
        levels = np.round(255 * linear ** (1 / 2.2)).astype(np.uint8)
        ids = np.append(part, 0)[hit].astype(np.uint8).reshape(height, width)
        return ids, np.concatenate([levels, [[255, 255, 255]]]).astype(np.uint8)[hit].reshape(height, width, 3)

    def render(self, R_m2c):
        ids, rgb = self.ids_and_rgb(R_m2c)
        pixels = np.array([np.count_nonzero(ids == part) for part in range(1, len(self.spec.parts) + 1)]) / N**2
        return View(rgb[1::N, 1::N].copy(), ids[1::N, 1::N].copy(), pixels)

    def marking_pixels(self, R_m2c):
        self.counted += len(R_m2c)
        counts = [np.count_nonzero(np.isin(self.ids_and_rgb(R)[0], self.spec.mesh.breaking)) for R in R_m2c]
        return np.array(counts, dtype=float) / N**2

    def label_windows(self, R_m2c):
        return [LabelWindow(lit.window, lit.ids) for lit in self.lit_windows(R_m2c)]

    def lit_windows(self, R_m2c):
        self.drawn += len(R_m2c)
        found = []
        for R in R_m2c:
            ids, rgb = self.ids_and_rgb(R)
            world = self.spec.mesh.marking_vertices @ R.T + np.array([0, 0, self.camera.distance])
            uv = N * (self.camera.focal_px * world[:, :2] / world[:, 2:] + self.camera.width / 2) + 0.5
            window = Window.around_each(uv[None], ids.shape[1], ids.shape[0])[0]
            found.append(LitWindow(window, ids[window.slices], rgb[window.slices]))
        return found

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()
