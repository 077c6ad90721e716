"""Who gives way to whom inside the junctions of a SUMO network."""

from deepmf_sumo.network.net_file import NetFile


def going_first(net: NetFile) -> dict[str, tuple[str, ...]]:
    """Lanes inside a junction whose traffic goes first, by the lane inside that gives way.

    From the ``response`` of the junctions' ``<request>``. A link that waits in the middle of the
    junction has several lanes: all of them stand for it, on both sides. Links that give way to
    nobody are left out. At lights it holds while both are green.
    """
    after = {link.origin: link.via for link in net.links if link.origin.startswith(":")}
    chains: dict[str, tuple[str, ...]] = {}
    for link in net.links:
        if link.via and not link.origin.startswith(":"):
            chain = [link.via]
            while after.get(chain[-1]) and after[chain[-1]] not in chain:
                chain.append(after[chain[-1]])
            chains |= dict.fromkeys(chain, tuple(chain))
    found: dict[str, tuple[str, ...]] = {}
    for junction in net.junctions:
        of_row = [chains.get(lane, ()) for lane in junction.inner_lanes]
        for mine, first in zip(of_row, junction.goes_first, strict=False):
            others = tuple(
                lane for row in sorted(first) if row < len(of_row) for lane in of_row[row]
            )
            if others:
                found |= dict.fromkeys(mine, others)
    return found
