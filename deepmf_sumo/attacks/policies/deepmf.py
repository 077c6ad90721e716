"""DeepMF as a policy: the plug-in for `deepmf_sumo.deepmf`."""

from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.deepmf.settings import Settings

__all__ = ["Settings", "build"]
