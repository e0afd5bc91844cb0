"""What fits into a device's memory."""

import torch

from symsol_annot.bench.models.devices import largest_that_fits


def test_halving_ends_with_none_where_not_even_one_fits():
    def never(_):
        raise torch.cuda.OutOfMemoryError

    def hungry(batch_size):
        if batch_size > 20:
            raise torch.cuda.OutOfMemoryError
        return f"{batch_size} images"

    assert largest_that_fits(never, 64) is None
    assert largest_that_fits(hungry, 0) is None
    assert largest_that_fits(hungry, 64) == (16, "16 images")
    assert largest_that_fits(hungry, 7) == (7, "7 images")
