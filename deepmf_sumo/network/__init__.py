"""Scene -> SUMO network, and SUMO network -> road map."""

from deepmf_sumo.network.cache import cached
from deepmf_sumo.network.conversion import convert
from deepmf_sumo.network.mapping import read

__all__ = ["cached", "convert", "read"]
