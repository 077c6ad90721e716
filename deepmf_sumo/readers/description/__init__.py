"""Parts of a ScenarioNet scene description: the road and the signals, in all their forms."""

from deepmf_sumo.readers.description.road import road
from deepmf_sumo.readers.description.signals import signals

__all__ = ["road", "signals"]
