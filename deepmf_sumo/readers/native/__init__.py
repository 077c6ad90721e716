"""The native format: which arrays of the file hold which part of a scene."""

from deepmf_sumo.readers.native.layout import FORMAT_VERSION, NAMES, from_arrays, to_arrays

__all__ = ["FORMAT_VERSION", "NAMES", "from_arrays", "to_arrays"]
