"""``report.html``: all runs of a result folder on one page, each with a replay."""

from deepmf_sumo.report.page.document import write

__all__ = ["write"]
