"""Parts of a Nocturne or GPUDrive scene, in all their forms: motion, road, signals."""

from deepmf_sumo.readers.nocturne.motion import AV_SIZE_M, av_by_size, tracks
from deepmf_sumo.readers.nocturne.road import road
from deepmf_sumo.readers.nocturne.signals import signals

__all__ = ["AV_SIZE_M", "av_by_size", "road", "signals", "tracks"]
