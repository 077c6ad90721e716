"""How many threads torch computes with."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread, and afterwards as many as before.

    The networks are small: on cores that SUMO and others use as well, several threads wait for one
    another most of the time. The number is the whole process's, which may be a user's script.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
