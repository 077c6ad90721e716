"""Which futures of an opponent break no rule of the road, as far as the road map tells the rules.

A future is lawful if

- it stays on lanes that can be reached from the lane where it begins, in their direction;
- it drives no faster than 110 % of their limit, or than it does now;
- it crosses no stop line (by more than 2 m) at red, or of a stop sign without standing before it,
  where 5 m/s2 of braking were enough to stop in time, and none at yellow where 3 m/s2 were;
- it comes into the AV's way only with 1.5 s to spare before the AV, if the AV goes on as if nobody
  attacked: on a link over a junction that gives way to the AV's, or when it leaves its lane; out
  of its lane it touches the AV in none of its reactions;
- behind the AV it neither touches it nor speeds up within 1 s of it; before it, where no line makes
  it stop and no turn slow down, it brakes by no more than 2 m/s2, and keeps half of its speed.

Where the AV comes into the opponent's way none of this holds: that is what a lawful attack is.
Lights are taken to stay as they are until the next plan. What the map does not tell restricts
nothing: recordings know no right of way at junctions, and who begins off the lanes may drive
anywhere. Others than the AV are not looked at.
"""

from deepmf_sumo.policies.factorization.lawful.law import Law
from deepmf_sumo.policies.factorization.lawful.lines import stops

__all__ = ["Law", "stops"]
