"""Networks with attacks -> one folder each: CSV, edge data, polygons, a page."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from deepmf_sumo import files, tables
from deepmf_sumo.errors import OutputError
from deepmf_sumo.report import evidence
from deepmf_sumo.report.page.document import map_page
from deepmf_sumo.report.risk import gis, sumo_files
from deepmf_sumo.results import risk, stored
from deepmf_sumo.results.folder import RISK, RISK_FILES, forget_map, map_folders
from deepmf_sumo.results.risk import Network, PlaceRow

TABLE, PAGE, EDGES, MOVEMENTS = "risk.csv", "risk.html", "edges.xml", "movements.xml"
POLYGONS, CONFIG, CONFLICTS = "polygons.add.xml", "risk.sumocfg", "conflicts.csv"
TYPES, COVERAGE, ATTACKS = "types.csv", "coverage.csv", "attacks.csv"
TABLES: Final = (TABLE, ATTACKS, TYPES, COVERAGE, CONFLICTS)
DRAWN: Final = (PAGE, EDGES, MOVEMENTS, POLYGONS, CONFIG)


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """The files of one network, and the rows in them; ``more``: names of the files of `gis`."""

    folder: Path
    network: Network
    rows: list[PlaceRow]
    more: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """All files of the map."""
        net = f"net.net.xml{'.gz' * (self.network.net_file.suffix == '.gz')}"
        return [self.folder / name for name in (*TABLES, *DRAWN, net, *self.more)]


def write(
    out: Path, networks: Sequence[Network], title: str = "", forms: Sequence[gis.Form] = ()
) -> list[Written]:
    """Write the risk map of each network: into ``out``, or into one folder each if several.

    Args:
        out: made if it is not there; files of an earlier map are replaced, also where that was of
            other networks. Other files in it stay.
        networks: of `results.risk.read`.
        title: of the page, e.g. the name of the result folder.
        forms: for geographic information systems as well, see `gis`.

    Raises OutputError where a folder cannot be written, or holds other files and no map; and before
    anything is written UsageError where a network cannot be written in one of the forms.
    """
    gis.check(networks, forms)
    with files.writing(out):
        _check_place(out)
    written = []
    for number, network in enumerate(networks):
        folder = out if len(networks) == 1 else out / f"{number + 1}-{network.name}"
        with files.writing(folder):
            written.append(_write(folder, network, title or network.name, forms))
    with files.writing(out):
        made = {file for one in written for file in one.files}
        forget_map(out, keep=made)
    return written


def _check_place(out: Path) -> None:
    """Refuse a folder of something else; that of a result folder, or of a map, may hold more."""
    if out.name == RISK and (out.parent / stored.MANIFEST).is_file():
        return
    if any((folder / PAGE).is_file() for folder in map_folders(out)) or not out.exists():
        return
    maps = map_folders(out)
    others = [
        path.name
        for folder in maps
        for path in folder.iterdir()
        if not path.name.startswith(".") and path not in maps
    ]
    # a command that was killed has left a part of a map, which begins with its table
    begun = any((folder / TABLE).is_file() for folder in maps) and RISK_FILES.issuperset(others)
    if others and not begun:
        raise OutputError(f"{out} holds '{min(others)}'; choose an empty folder for --out.")


def _write(folder: Path, network: Network, title: str, forms: Sequence[gis.Form]) -> Written:
    folder.mkdir(parents=True, exist_ok=True)
    rows = risk.rows(network)
    mapped = gis.written(network, rows, forms)
    files.remove_parts(folder)
    files.write(folder / TABLE, tables.to_csv([risk.columns(row) for row in rows]))
    net = "".join(["net.net.xml", ".gz" * (network.net_file.suffix == ".gz")])
    files.copy(network.net_file, folder / net)
    files.write(folder / CONFLICTS, tables.to_csv([asdict(one) for one in risk.conflicts(network)]))
    by_type = [asdict(one) for one in risk.by_type(network.attacks)]
    files.write(folder / TYPES, tables.to_csv(by_type))
    covered = [evidence.values(one) for one in risk.coverage(network)]
    files.write(folder / COVERAGE, tables.to_csv(covered))
    attacks = tables.to_csv(risk.attack_rows(network), risk.ATTACKED, cell=tables.exact)
    files.write(folder / ATTACKS, attacks)
    files.write(folder / EDGES, sumo_files.edges(network, rows))
    files.write(folder / MOVEMENTS, sumo_files.movements(network, rows))
    files.write(folder / POLYGONS, sumo_files.additional(network, rows))
    files.write(folder / CONFIG, _config(net))
    files.write(folder / PAGE, map_page(network, rows, title))
    for name, content in mapped.items():
        files.write(folder / name, content)
    return Written(folder=folder, network=network, rows=rows, more=tuple(mapped))


def _config(net: str) -> str:
    """What ``sumo-gui -c`` opens: the network with the polygons, and no traffic."""
    return f"""<configuration>
    <input>
        <net-file value="{net}"/>
        <additional-files value="{POLYGONS}"/>
    </input>
    <time>
        <begin value="0"/>
        <end value="1"/>
    </time>
    <gui_only>
        <edgedata-files value="{EDGES}"/>
    </gui_only>
</configuration>
"""
