"""Cases of SUMO configurations."""

from pathlib import Path

from deepmf_sumo.scene import AgentId, TrafficCase, TurnRules
from deepmf_sumo.sumo.network.sumo_road import road_once
from deepmf_sumo.sumo.simulation.sumo_config import read_configuration


def network_case(
    config: Path,
    start_s: float,
    av: AgentId,
    duration_steps: int = 80,
    seed: int = 0,
    name: str = "",
    sumo_options: tuple[str, ...] = (),
    turns: TurnRules | None = None,
    only: tuple[AgentId, ...] | None = None,
    *,
    own_people: bool = True,
) -> TrafficCase:
    """The case of a .sumocfg whose vehicle ``av`` the planner drives from ``start_s`` on.

    ``sumo_options``: beside the configuration, as on SUMO's command line. ``turns``: opponents
    attack in turn. ``only``: road users beside the AV. ``own_people``: see `TrafficCase`.

    Raises SimulationError if the configuration or its network is missing. Whether the vehicle is
    present at the start is known only in the simulation.
    """
    configuration = read_configuration(config, sumo_options)
    return TrafficCase(
        name=name or f"{config.stem}-{av}-{start_s:g}s",
        road=road_once(configuration.net, configuration.additional),
        av_id=av,
        duration_steps=duration_steps,
        seed=seed,
        config=config,
        start_s=start_s,
        net_file=configuration.net,
        sumo_options=sumo_options,
        turns=turns,
        only=only,
        own_people=own_people,
    )
