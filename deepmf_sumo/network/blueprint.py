"""The network to build, in SUMO's terms: nodes, edges with lanes, links.

It is written as plain XML, and its shapes are put back after netconvert has changed them.
"""

from dataclasses import dataclass, field
from typing import Literal

from deepmf_sumo.datatypes import Floats

NodeKind = Literal["priority", "priority_stop", "allway_stop", "traffic_light"]
LinkKind = Literal["path", "joint", "bridge"]
LaneRef = tuple[str, int]
"""A SUMO edge and the index of the lane in it, counted from the right."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NodePlan:
    """A junction at (2) a position."""

    id: str
    position_m: Floats
    kind: NodeKind = "priority"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LanePlan:
    """A lane of an edge; ``scene_lane`` is None for lanes that the scene does not have.

    Attributes:
        shape_m: (P, 2).
        start_m: where on the scene's lane it begins.
    """

    shape_m: Floats
    speed_mps: float
    width_m: float
    scene_lane: str | None = None
    start_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgePlan:
    """An edge between two nodes; its lanes from right to left."""

    id: str
    start: str
    end: str
    lanes: tuple[LanePlan, ...]
    bike: bool = False
    priority: int = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkPlan:
    """A way from lane to lane.

    Attributes:
        shape_m: (P, 2).
        path: the scene's lanes that the shape consists of.
        kind: made of the ``path``'s lanes; a ``joint`` of two lanes that touch, drawn on the end of
            the first; or a ``bridge`` over a gap in the scene's map.
        speed_mps: what can be driven there at least.
    """

    origin: LaneRef
    target: LaneRef
    shape_m: Floats
    path: tuple[str, ...] = ()
    kind: LinkKind = "path"
    speed_mps: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blueprint:
    """All of it.

    Attributes:
        edges: by id.
        signalled: scene lane -> (origin, target) of the links that carry its light.
    """

    nodes: tuple[NodePlan, ...]
    edges: dict[str, EdgePlan]
    links: tuple[LinkPlan, ...]
    signalled: dict[str, tuple[tuple[LaneRef, LaneRef], ...]] = field(default_factory=dict)
    ghost_edge: str | None = None

    def lane(self, ref: LaneRef) -> LanePlan:
        """The plan of a lane."""
        return self.edges[ref[0]].lanes[ref[1]]
