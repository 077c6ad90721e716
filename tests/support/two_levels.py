"""A road that passes 8 m above another, and a ramp that comes down to it, built by netconvert."""

import os
import subprocess
from pathlib import Path

import sumo

BRIDGE_M = 8.0
# below runs to the east along y = 0; above to the north along x = 0, level for 80 m; the ramp
# begins 8 m up and joins the road below at (250, 0)
NODES = """<nodes>
<node id="w" x="-300" y="0" z="0"/><node id="j" x="250" y="0" z="0" type="unregulated"/>
<node id="e" x="500" y="0" z="0"/>
<node id="s" x="0" y="-300" z="0"/><node id="n" x="0" y="300" z="0"/>
<node id="u" x="50" y="80" z="8"/></nodes>"""
EDGES = """<edges>
<edge id="below" from="w" to="j" speed="15"/><edge id="out" from="j" to="e" speed="15"/>
<edge id="ramp" from="u" to="j" speed="15"/>
<edge id="above" from="s" to="n" speed="15"
      shape="0,-300,0 0,-140,0 0,-40,8 0,40,8 0,140,0 0,300,0"/></edges>"""
ROUTES = """<routes>
<vType id="steady" maxSpeed="10" sigma="0" speedFactor="1" length="5" width="1.8"/>
<vehicle id="av" type="steady" depart="0" departPos="200" departSpeed="10">
  <route edges="below out"/></vehicle>
<vehicle id="leads" type="steady" depart="0" departPos="330" departSpeed="10">
  <route edges="below out"/></vehicle>
<vehicle id="over" type="steady" depart="0" departPos="200" departSpeed="10">
  <route edges="above"/></vehicle>
<vehicle id="joins" type="steady" depart="14.4" departPos="10" departSpeed="10">
  <route edges="ramp out"/></vehicle>
</routes>"""
CONFIG = """<configuration><input><net-file value="levels.net.xml"/>
<route-files value="levels.rou.xml"/></input>
<time><step-length value="0.1"/></time></configuration>"""


def build(folder: Path) -> Path:
    """Write network, routes and configuration; returns the .sumocfg."""
    for name, text in (("nod", NODES), ("edg", EDGES), ("rou", ROUTES)):
        (folder / f"levels.{name}.xml").write_text(text)
    config = folder / "levels.sumocfg"
    config.write_text(CONFIG)
    command = [str(Path(sumo.SUMO_HOME) / "bin" / "netconvert"), "-n", "levels.nod.xml"]
    command += ["-e", "levels.edg.xml", "-o", "levels.net.xml"]
    command += ["--offset.disable-normalization", "true"]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
    return config


def height_above(y: float) -> float:
    """Of the road above, by hand."""
    return min(max((140.0 - abs(y)) / 100.0, 0.0), 1.0) * BRIDGE_M
