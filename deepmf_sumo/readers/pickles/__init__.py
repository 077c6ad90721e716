"""Pickles of plain data: numpy arrays in plain containers, and nothing that can act."""

from deepmf_sumo.readers.pickles.unpickler import ForbiddenClassError, load_plain

__all__ = ["ForbiddenClassError", "load_plain"]
