"""A street with a bus that persons ride, persons on foot with the ids of vehicles, a container."""

import os
import subprocess
from pathlib import Path

import sumo

NODES = """<nodes><node id="a" x="0" y="0"/><node id="b" x="300" y="0"/><node id="c" x="600" y="0"/>
</nodes>"""
EDGES = """<edges><edge id="ab" from="a" to="b" numLanes="2" speed="13.9" sidewalkWidth="2"/>
<edge id="bc" from="b" to="c" numLanes="2" speed="13.9" sidewalkWidth="2"/></edges>"""
STOPS = """<additional>
<busStop id="first" lane="ab_1" startPos="80" endPos="110"/>
<busStop id="last" lane="bc_1" startPos="100" endPos="130"/>
<containerStop id="yard" lane="ab_1" startPos="150" endPos="180"/>
<containerStop id="port" lane="bc_1" startPos="150" endPos="180"/>
</additional>"""
ROUTES = """<routes><vType id="bus" vClass="bus"/><vType id="truck" vClass="truck"/>
<route id="all" edges="ab bc"/>
<vehicle id="0" depart="0" departPos="20" departLane="1" type="bus" route="all">
  <stop busStop="first" duration="6"/><stop busStop="last" duration="6"/></vehicle>
<vehicle id="1" depart="0" departPos="60" departLane="2" departSpeed="10" route="all"/>
<vehicle id="2" depart="0" departPos="10" departLane="2" departSpeed="10" route="all"/>
<person id="0" depart="0" departPos="85"><ride from="ab" busStop="last" lines="ANY"/>
  <walk to="bc"/></person>
<person id="rider" depart="0" departPos="90"><ride from="ab" busStop="last" lines="0"/>
  <walk to="bc"/></person>
<person id="1" depart="0" departPos="200"><walk from="ab" to="bc"/></person>
<person id="late" depart="0" departPos="220"><walk from="ab" to="bc"/></person>
<person id="taken" depart="triggered"><ride from="ab" to="bc" lines="2"/></person>
<container id="3" depart="0"><tranship from="ab" containerStop="yard" speed="20"/>
  <transport containerStop="port" lines="3"/></container>
<vehicle id="3" depart="2" departPos="5" departLane="1" type="truck" route="all">
  <stop containerStop="yard" duration="4"/><stop containerStop="port" duration="4"/></vehicle>
<vehicle id="late" depart="25" departLane="2" departSpeed="10" route="all"/>
</routes>"""
CONFIG = """<configuration><input><net-file value="mixed.net.xml"/>
<route-files value="mixed.rou.xml"/><additional-files value="mixed.add.xml"/></input>
<time><end value="60"/></time></configuration>"""


def build(folder: Path) -> Path:
    """The configuration."""
    texts = {"nod": NODES, "edg": EDGES, "add": STOPS, "rou": ROUTES}
    for kind, text in texts.items():
        (folder / f"mixed.{kind}.xml").write_text(text)
    command = [Path(sumo.SUMO_HOME) / "bin" / "netconvert", "-o", "mixed.net.xml"]
    command += ["-n", "mixed.nod.xml", "-e", "mixed.edg.xml"]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
    (folder / "mixed.sumocfg").write_text(CONFIG)
    return folder / "mixed.sumocfg"
