"""How many threads torch computes with."""

import pytest
import torch

from deepmf_sumo.deepmf.networks.weights import one_thread


def test_one_thread_within_and_as_many_as_before_after():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with one_thread():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
        with pytest.raises(ValueError, match="a plan"), one_thread():
            raise ValueError("a plan")
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
