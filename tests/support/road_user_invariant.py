"""Invariant of every simulated frame: agents = SUMO's vehicles on the road + persons on foot.

Who rides is asked of the vehicles here, and of the persons in the product.
"""

from deepmf_sumo.live.observer import LiveObserver
from deepmf_sumo.sumo.simulation.road_users import TrafficReader


def use(patch) -> None:
    """Check each frame that is read from SUMO."""
    read = TrafficReader.states

    def checked(reader):
        states = read(reader)
        expected = on_the_road(reader._api)
        found = {agent.partition(" part ")[0] for agent in states}
        assert found == expected, f"agents are not the road users: {found ^ expected}"
        return states

    look = LiveObserver.look

    def checked_look(observer):
        sighting = look(observer)
        if sighting is not None and sighting.persons:  # each question is a message
            found, expected = {*sighting.all()}, on_the_road(observer._api)
            more = {agent.partition(" part ")[0] for agent in found} - expected
            assert not more, f"agents that are no road users: {more}"
        return sighting

    patch.setattr(TrafficReader, "states", checked)
    patch.setattr(LiveObserver, "look", checked_look)


def on_the_road(api) -> set[str]:
    """The agents that there have to be."""
    vehicles = set(api.vehicle.getIDList()) - set(api.vehicle.getTeleportingIDList())
    persons = set(api.person.getIDList())
    if persons:
        persons -= {one for name in vehicles for one in api.vehicle.getPersonIDList(name)}
    return vehicles | {f"person {name}" for name in persons}
