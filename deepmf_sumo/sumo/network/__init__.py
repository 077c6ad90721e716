"""Scene -> SUMO network, and SUMO network -> road map."""

from deepmf_sumo.sumo.network.conversion import cached, convert
from deepmf_sumo.sumo.network.mapping import read

__all__ = ["cached", "convert", "read"]
