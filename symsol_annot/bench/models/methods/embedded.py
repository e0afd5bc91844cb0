"""A split's images embedded block by block, as methods ask about them: one image after another."""

from collections.abc import Callable
from functools import lru_cache

from torch import Tensor

from symsol_annot.bench.models.batches import decode_images
from symsol_annot.bench.models.networks.answers import embeddings_of
from symsol_annot.bench.models.networks.reference_model import ReferenceModel
from symsol_annot.sets.dataset import Dataset

BLOCK = 512  # images decoded at once


def embedded_blocks(
    model: ReferenceModel, dataset: Dataset, input_size: int, batch_size: int
) -> Callable[[int], Tensor]:
    """Return a callable from a block's number to the embeddings (b, E) of its 512 images; it keeps the last two.

    Args:
        model: that embeds them.
        dataset: whose images they are.
        input_size: the side in pixels that they are reduced to; 0 for images as they are.
        batch_size: how many are embedded at once.
    """

    @lru_cache(maxsize=2)  # threads that look ahead are in two at once, where one block ends
    def embeddings_in(block: int) -> Tensor:
        images = decode_images(dataset[block * BLOCK : (block + 1) * BLOCK], input_size).images
        return embeddings_of(model, images, batch_size)

    return embeddings_in
