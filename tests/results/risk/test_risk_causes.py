"""The tables of evidence and the groups of failures say the same of the same folder."""

import numpy as np
import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.results import risk
from deepmf_sumo.results.failures import failures
from deepmf_sumo.results.groups import causes, grouped
from deepmf_sumo.results.reader import Results
from deepmf_sumo.results.result import COLUMNS, known_of
from deepmf_sumo.results.stored import result_of
from deepmf_sumo.tables import to_csv

from tests.support.risk_doubles import NET, Attacks, eastward, straight

CAUSES = [
    # rung, error of the AV, change
    ("A", "struck_ahead", "brake"), ("A", "struck_ahead", "brake"), ("B", "", "brake"),
    ("B", "", "wait"), ("C", "", "brake"), (None, "", ""),
]  # fmt: skip


@pytest.fixture
def out(tmp_path):
    """Six hits from behind and six from the side, of which four each have one of three causes."""
    runs = Attacks(tmp_path / "out")
    across = straight((-90.0, -34.8), 10.0, np.pi / 2)
    for way, opponent in (("behind", eastward(x=-156.0)), ("side", across)):
        for number, (rung, error, change) in enumerate(CAUSES):
            told = {"rung": rung, "reasons": [], "av_error": error, "opponent_error": "",
                    "avoided_by": ["cc"]}  # fmt: skip
            cause = {"change": change, "what": "to brake", "last_moment_s": {}, "changes": {}}
            runs.add(
                f"{way} {number}", av=eastward(), opponent=opponent, hit=40,
                finding=told if rung else None, cause=cause if rung in {"A", "B"} else None,
            )  # fmt: skip
    files = sorted(runs.out.glob("runs/*/result.json"))
    table = to_csv((known_of(result_of(file)) for file in files), COLUMNS)
    (runs.out / "runs.csv").write_text(table)
    return runs.out


def agreed(out):
    """Hits by run, as groups of failures have them, and the table of kinds of conflict."""
    looked = list(failures(Results.open(out)))
    assert {why for *_, why in looked} == {""}
    found = {run.run_id: one for run, one, _ in looked if one is not None}
    [network] = risk.read([out])
    attacks = {one.run_id: one for one in network.attacks if one.hit}
    assert found.keys() == attacks.keys()
    for run_id, one in found.items():
        assert one.conflict == attacks[run_id].kind
        assert one.cause == attacks[run_id].cause
    cells = [one for one in risk.coverage(network) if one.table == "conflict"]
    number, _ = causes(grouped(found.values(), len(looked)))
    assert sum(one.causes for one in cells) == number
    return found


def test_kinds_and_causes_are_those_of_the_groups(out):
    found = agreed(out)
    assert len({one.conflict for one in found.values()}) == 2
    assert causes(grouped(found.values(), 12)) == (6, 8)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_they_are_in_real_attacks(tmp_path):
    config, out = NET.parent / "four_way.sumocfg", tmp_path / "out"
    any_hit = ("--set", "profile=any", "--set", "adversary.constraints=[on_road]")
    arguments = ["--moments", "6", "--seed", "2", *any_hit, "--no-pictures"]
    assert main.run(["attack", str(config), *arguments, "--out", str(out)]) == 0
    assert len(agreed(out)) >= 2
