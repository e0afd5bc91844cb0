"""Working out the answers about the next images while one is waited for, an image per thread."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import torch

from symsol_annot.bench.predictions.writing.answer_file import Answer

Answers = Callable[[int], Answer]


@contextlib.contextmanager
def looking_ahead(images: int) -> Iterator[Callable[[Answers], Answers]]:
    """Give what makes a callable of one that answers about images, which are asked about in their order.

    Several images at once take a CPU less time than one whose products are shared among threads. What is answered does
    not depend on it. The callable must not keep anything for the next image.
    """
    threads = torch.get_num_threads()

    def ahead(answer: Answers) -> Answers:
        begun: dict[int, Future[Answer]] = {}

        def ask(i: int) -> Answer:
            for j in range(i, min(i + threads + 1, images)):
                if j not in begun:
                    begun[j] = pool.submit(answer, j)
            return begun.pop(i).result()

        return ask

    with ThreadPoolExecutor(threads, initializer=_begin_thread) as pool:
        try:
            yield ahead
        finally:
            torch.set_num_threads(threads)  # what a thread says of some libraries' holds for all


def _begin_thread() -> None:
    torch.set_grad_enabled(mode=False)
    torch.set_num_threads(1)
