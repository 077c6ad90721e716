"""Exporters: a rollout in a format that other programs read, one module per format.

The module is the exporter, see `base.Exporter`::

    FILE = "tracks.geojson"

    def write(rollout: Rollout, case: Case, path: Path) -> None: ...

Its name is that of the format. Exporters of other packages join through the entry point group
``deepmf_sumo.exporters``; see `plugins`.
"""
