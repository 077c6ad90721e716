"""What every recorded scene has to satisfy, and how little is mended where it does not."""

from deepmf_sumo.readers.checks.ids import identifier
from deepmf_sumo.readers.checks.recording import (
    MOST_STATES,
    Recording,
    RecordingTracks,
    checked,
    confirmed,
)
from deepmf_sumo.readers.checks.road import MOST_FEATURES, is_placed

__all__ = [
    "MOST_FEATURES",
    "MOST_STATES",
    "Recording",
    "RecordingTracks",
    "checked",
    "confirmed",
    "identifier",
    "is_placed",
]
