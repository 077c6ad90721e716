"""The risk map of a SUMO network in files that its engineers open."""

from deepmf_sumo.report.risk.folder import PAGE, Written, write

__all__ = ["PAGE", "Written", "write"]
