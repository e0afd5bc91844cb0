"""Answers about the next images are begun early, and are those of asking one image after another."""

import threading

import pytest
import torch

from symsol_annot.bench.models.methods.ahead import looking_ahead


def test_answers_are_those_of_the_images_that_are_asked_about_some_left_out():
    with looking_ahead(20) as ahead:
        ask = ahead(lambda i: {"i": torch.tensor(i)})
        assert [int(ask(i)["i"]) for i in (0, 1, 2, 7, 8, 19)] == [0, 1, 2, 7, 8, 19]


def test_an_image_is_worked_out_once_and_the_next_ones_meanwhile():
    begun, next_has_begun = [], threading.Event()

    def answer(i):
        begun.append(i)
        if i == 1:
            next_has_begun.set()
        return {}

    with looking_ahead(6) as ahead:
        ask = ahead(answer)
        ask(0)
        assert next_has_begun.wait(30)
        for i in range(1, 6):
            ask(i)
    assert sorted(begun) == list(range(6))


def test_threads_share_no_products_and_keep_no_gradients():
    def answer(_):
        return {"threads": torch.get_num_threads(), "gradients": torch.is_grad_enabled()}

    before = torch.get_num_threads()
    with looking_ahead(3) as ahead:
        assert ahead(answer)(0) == {"threads": 1, "gradients": False}
    assert torch.is_grad_enabled()
    assert torch.get_num_threads() == before


def test_an_error_comes_with_the_image_it_is_about():
    def answer(i):
        if i == 2:
            raise ValueError("image 2")
        return {}

    with looking_ahead(5) as ahead:
        ask = ahead(answer)
        assert ask(0) == ask(1) == {}
        with pytest.raises(ValueError, match="image 2"):
            ask(2)
        assert ask(3) == {}
