"""A junction whose roads have footways, crossings and, east to west, cycle lanes: netconvert.

The road from west to east has, from the right: footway ``wm_0`` (y = 191.1), cycle lane ``wm_1``
(192.85), lanes ``wm_2`` (195.2) and ``wm_3`` (198.4); the junction is at (200, 200). The road from
south to north has one lane a direction, ``sm_1`` at x = 201.6, and footway ``sm_0`` at 204.2.
"""

import os
import subprocess
from pathlib import Path

import sumo

NODES = """<nodes><node id="w" x="-200" y="0"/><node id="m" x="0" y="0" type="priority"/>
<node id="e" x="200" y="0"/><node id="n" x="0" y="200"/><node id="s" x="0" y="-200"/></nodes>"""
WIDE = 'numLanes="2" speed="13.8" priority="3" sidewalkWidth="2" bikeLaneWidth="1.5"'
NARROW = 'numLanes="1" speed="13.8" priority="1" sidewalkWidth="2"'
ARMS = (*((end, WIDE) for end in "we"), *((end, NARROW) for end in "ns"))
EDGES = "".join(
    f'<edge id="{a}{b}" from="{a}" to="{b}" {what}/>'
    for end, what in ARMS
    for a, b in ((end, "m"), ("m", end))
)
TYPES = """<vType id="car" sigma="0" speedDev="0"/><vType id="bike" vClass="bicycle" speedDev="0"/>
<vType id="walker" vClass="pedestrian" speedDev="0" maxSpeed="1.4"/>"""
CONFIG = """<configuration><input><net-file value="pavements.net.xml"/>
<route-files value="pavements.rou.xml"/>{more}</input></configuration>"""
STOPS = """<additional><busStop id="stop" lane="wm_2" startPos="100" endPos="130"/></additional>"""


def car(name, edges, lane, pos, speed=10.0, kind="car", depart=0.0):
    """A vehicle."""
    return (
        f'<vehicle id="{name}" type="{kind}" depart="{depart}" departLane="{lane}" '
        f'departPos="{pos}" departSpeed="{speed}"><route edges="{edges}"/></vehicle>'
    )


def walker(name, edges, pos, arrival=50.0):
    """A person who walks."""
    return (
        f'<person id="{name}" type="walker" depart="0" departPos="{pos}">'
        f'<walk edges="{edges}" arrivalPos="{arrival}"/></person>'
    )


def build(folder: Path, *demand: str, types: str = TYPES) -> Path:
    """Write network and demand; returns the .sumocfg."""
    texts = {"nod": NODES, "edg": f"<edges>{EDGES}</edges>", "add": STOPS}
    texts["rou"] = f"<routes>{types}{''.join(demand)}</routes>"
    for kind, text in texts.items():
        (folder / f"pavements.{kind}.xml").write_text(text)
    if not (folder / "pavements.net.xml").exists():
        command = [str(Path(sumo.SUMO_HOME) / "bin" / "netconvert"), "-n", "pavements.nod.xml"]
        command += ["-e", "pavements.edg.xml", "-o", "pavements.net.xml"]
        command += ["--sidewalks.guess", "--crossings.guess", "--walkingareas"]
        environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
        subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
    config = folder / "pavements.sumocfg"
    config.write_text(CONFIG.format(more='<additional-files value="pavements.add.xml"/>'))
    return config
