"""A road that climbs, and a road on two storeys, built by netconvert."""

from pathlib import Path

from deepmf_sumo.sumo.network import sumo_tools

SLOPE = 0.1
SLOPE_NODES = """<nodes><node id="foot" x="0" y="0" z="0"/>
<node id="top" x="400" y="0" z="40"/></nodes>"""
SLOPE_EDGES = """<edges><edge id="up" from="foot" to="top" numLanes="2" speed="14"/></edges>"""
SLOPE_ROUTES = """<routes><vType id="car" sigma="0" speedFactor="1"/>
<vehicle id="av" type="car" depart="0" departPos="20" departSpeed="10"><route edges="up"/></vehicle>
</routes>"""
STOREY_M = 8.0
# below: a road to the east with a junction with lights and crossings at x = 0, and a parked car;
# the deck is right above it
STOREY_NODES = """<nodes><node id="w" x="-300" y="0"/>
<node id="m" x="0" y="0" type="traffic_light"/>
<node id="e" x="300" y="0"/><node id="s" x="0" y="-200"/><node id="n" x="0" y="200"/>
<node id="dw" x="-300" y="0" z="8"/><node id="de" x="300" y="0" z="8"/></nodes>"""
STOREY_EDGES = """<edges><edge id="in" from="w" to="m" speed="14" sidewalkWidth="2"/>
<edge id="out" from="m" to="e" speed="14" sidewalkWidth="2"/>
<edge id="south" from="s" to="m" speed="14" sidewalkWidth="2"/>
<edge id="north" from="m" to="n" speed="14" sidewalkWidth="2"/>
<edge id="deck" from="dw" to="de" speed="14"/></edges>"""
STOREY_ROUTES = """<routes><vType id="car" sigma="0" speedFactor="1"/>
<vehicle id="parked" type="car" depart="0" departPos="255" departSpeed="0">
  <route edges="in out"/><stop lane="in_1" endPos="260" parking="true" duration="500"/></vehicle>
<vehicle id="below" type="car" depart="5" departPos="220" departSpeed="10">
  <route edges="in out"/></vehicle>
<vehicle id="above" type="car" depart="5" departPos="220" departSpeed="10">
  <route edges="deck"/></vehicle></routes>"""


def slope(folder: Path) -> Path:
    """The road that climbs by 10 %; returns the .sumocfg. The AV starts 20 m from its foot."""
    return _built(folder, SLOPE_NODES, SLOPE_EDGES, SLOPE_ROUTES)


def storeys(folder: Path) -> Path:
    """The road on two storeys; returns the .sumocfg, with a vehicle ``above`` and ``below``."""
    return _built(
        folder, STOREY_NODES, STOREY_EDGES, STOREY_ROUTES, "--crossings.guess", "--walkingareas"
    )


def _built(folder: Path, nodes: str, edges: str, routes: str, *options: str) -> Path:
    for name, text in (("nod", nodes), ("edg", edges), ("rou", routes)):
        (folder / f"hills.{name}.xml").write_text(text)
    config = folder / "hills.sumocfg"
    config.write_text(
        '<configuration><input><net-file value="hills.net.xml"/>'
        '<route-files value="hills.rou.xml"/></input></configuration>'
    )
    files = (str(folder / f"hills.{name}.xml") for name in ("nod", "edg", "net"))
    given = [part for pair in zip(("-n", "-e", "-o"), files, strict=True) for part in pair]
    sumo_tools.run("netconvert", *given, "--offset.disable-normalization", *options)
    return config
