"""Two roads that cross, by default where nobody gives way, with a little traffic: netconvert."""

import os
import subprocess
from pathlib import Path

import sumo

NODES = """<nodes><node id="mid" x="0" y="0" type="{middle}"/><node id="w" x="-150" y="0"/>
<node id="s" x="0" y="-150"/><node id="e" x="150" y="0"/><node id="n" x="0" y="150"/>
<node id="f" x="300" y="0"/></nodes>"""
EDGES = """<edges><edge id="west" from="w" to="mid" priority="2"/>
<edge id="south" from="s" to="mid"/>
<edge id="east" from="mid" to="e" priority="2"/><edge id="north" from="mid" to="n"/>
<edge id="far" from="e" to="f"/></edges>"""
ROUTES = """<routes>
<route id="over" edges="west east far"/><route id="up" edges="south north"/>
<vehicle id="over1" depart="0" departSpeed="max" route="over"/>
<vehicle id="up1" depart="1" departSpeed="max" route="up"/>
<vehicle id="over2" depart="20" departSpeed="max" route="over"/>
<vehicle id="over3" depart="22" departSpeed="max" route="over"/>
</routes>"""
CONFIG = """<configuration><input><net-file value="{}"/>
<route-files value="crossing.rou.xml"/></input></configuration>"""


def build(
    folder: Path,
    *options: str,
    net: str = "crossing.net.xml",
    middle: str = "unregulated",
    routes: str = ROUTES,
) -> Path:
    """Write network, routes and configuration; returns the .sumocfg. ``middle``: its type."""
    nodes = NODES.format(middle=middle)
    for name, text in (("nod", nodes), ("edg", EDGES), ("rou", routes)):
        (folder / f"crossing.{name}.xml").write_text(text)
    config = folder / "crossing.sumocfg"
    config.write_text(CONFIG.format(net))
    command = [str(Path(sumo.SUMO_HOME) / "bin" / "netconvert"), "-n", "crossing.nod.xml"]
    command += ["-e", "crossing.edg.xml", "-o", net, *options]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
    return config
