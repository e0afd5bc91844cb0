"""Making one shard: its images drawn by a renderer, annotated, and written into a file in memory."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from symsol_annot import __version__
from symsol_annot.annotation.annotator import Annotator
from symsol_annot.errors import RendererCrashedError
from symsol_annot.rendering.renderer import Renderer
from symsol_annot.sets.manifest import ShardEntry
from symsol_annot.sets.plan import SetPlan, label_rotation
from symsol_annot.sets.shard.writer import ImageRecord, ShardWriter, storage_versions

OnShardImages = Callable[[int], object]  # told how many images of the shard are made by now, from 1 up


@dataclass(frozen=True)
class MadeShard:
    """A finished shard, on its way to the set's folder.

    Attributes:
        data: the file's bytes.
        sha256: of the bytes, where they were made.
        content_sha256: of its arrays, as `shards.content_sha256`.
        worker: who made it.
    """

    data: bytes
    sha256: str
    content_sha256: str
    worker: str


def software_of(renderer: Renderer) -> dict[str, str]:
    """Return the software that decides the bytes of a shard: name to version."""
    return {"symsol-annot": __version__, **storage_versions(), **renderer.versions}


class ShardMaker:
    """Makes the shards of a plan with one renderer.

    Args:
        plan: the set.
        renderer: draws its object.
        exhaustive: draw every candidate, also where geometry decides; the bytes are the same.
        worker: the name that its shards carry.
        check: called after each shard; it raises where the renderer's frames cannot be trusted.
    """

    is_spent = False  # lasts as long as its renderer

    def __init__(
        self,
        plan: SetPlan,
        renderer: Renderer,
        *,
        exhaustive: bool = False,
        worker: str = "",
        check: Callable[[], object] = lambda: None,
    ) -> None:
        self._plan, self._renderer, self._worker, self._check = plan, renderer, worker, check
        self._annotator = Annotator.for_object(plan.spec, plan.camera, plan.settings, renderer, exhaustive=exhaustive)
        self._is_closed = False

    def make(self, entry: ShardEntry, on_shard_images: OnShardImages) -> MadeShard:
        """Draw and annotate the images of one shard; it is handed out only if the renderer passes its check after it.

        Raises:
            RenderError: the renderer failed or crashed.
        """
        try:
            return self._made(entry, on_shard_images)
        finally:
            self._check()  # also after an error, which a damaged renderer can be the cause of

    def close(self) -> None:
        """Let go of the renderer; a shard under way in another thread ends as a crash."""
        self._is_closed = True
        self._renderer.close()

    def _made(self, entry: ShardEntry, on_shard_images: OnShardImages) -> MadeShard:
        manifest, group = self._plan.manifest(), self._plan.spec.symmetry_group
        annotated = manifest.is_annotated(entry.split)
        versions = software_of(self._renderer)
        counts = {"candidates_drawn": 0, "candidates_within_tolerance": 0}
        with ShardWriter(manifest.header(entry, versions), entry.images, group, annotated=annotated) as writer:
            for made in range(entry.images):
                if self._is_closed:
                    raise RendererCrashedError("the renderer was closed while it was drawing")
                writer.add(self._record(entry, entry.first_index + made, counts, annotated=annotated))
                on_shard_images(made + 1)
            file = writer.finish(counts)
        return MadeShard(file.data, hashlib.sha256(file.data).hexdigest(), file.content_sha256, self._worker)

    def _record(self, entry: ShardEntry, index: int, counts: dict[str, int], *, annotated: bool) -> ImageRecord:
        annotator = self._annotator
        R_gt = label_rotation(self._plan.seed, self._plan.spec.name, entry.split, index)
        view = self._renderer.render(R_gt)
        coset_px = annotator.shown_px(R_gt, view)
        if not annotated:
            return ImageRecord(view, R_gt, coset_px, None)
        annotation = annotator.annotate(R_gt, coset_px, view)
        drawn_px = annotation.candidate_px
        counts["candidates_drawn"] += int(np.count_nonzero(np.isfinite(drawn_px)))
        counts["candidates_within_tolerance"] += int(np.count_nonzero((drawn_px > 0) & ~annotator.is_shown(drawn_px)))
        return ImageRecord(view, R_gt, coset_px, annotation.mask, annotation.volume)
