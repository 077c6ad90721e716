"""TFRecord framing: records of a file in order, and by offset."""

from deepmf_sumo.readers.framing.tfrecord import (
    Broken,
    Record,
    framed,
    looks_framed,
    record_at,
    records,
)

__all__ = ["Broken", "Record", "framed", "looks_framed", "record_at", "records"]
