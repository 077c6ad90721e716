"""What every recorded scene has to satisfy, and how little is mended where it does not."""

from deepmf_sumo.readers.checks.recording import Recording, RecordingTracks, checked, confirmed
from deepmf_sumo.readers.checks.road import is_placed

__all__ = ["Recording", "RecordingTracks", "checked", "confirmed", "is_placed"]
