"""Exporters: a finished run in a format that other programs read, one module per format.

The module is the exporter, see `base.Exporter`::

    FILE = "tracks.geojson"

    class Settings(plugins.Settings):
        decimals: int = 2

    def write(run: Exportable, path: Path, settings: Settings) -> None: ...

Its name is that of the format. A ``check()`` may raise PluginError before any run is written, e.g.
where an extra is not installed. Exporters of other packages join through the entry point group
``deepmf_sumo.exporters``; see `plugins`.

Why so: teams work on a finding in the program that they have, so that the same run has to be the
same there. What classes and signals are is asked of `scene`; each format only says what it calls
them. Runs write `fcd` and `scene` themselves; nothing but optional rooms and commands imports the
other formats, and what only one of them needs is an extra.
"""
