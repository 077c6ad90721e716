"""Everything that touches SUMO: networks built and read, configurations, and the episode.

SUMO has its own frame (front bumper, degrees from north), its own words for what went wrong, and
one simulation a process. All of that stays behind this room: methods, planners and judgement get
the types of `deepmf_sumo.scene`. Rooms that ask for SUMO's own roads and traffic use it directly.

Why it is as it is:

- The AV's speed command is bounded by SUMO's own decision of the same step: ``setSpeed`` under
  speed mode 24 alone runs red lights. Moving vehicles are placed with a match threshold of 5 m
  (near 2 m SUMO takes wrong lanes), standing boxes with a threshold as narrow as they are.
- What is shown and judged of the AV is SUMO's own pose of that step, as a box centre. SUMO without
  its sublane model changes lanes within one step: such a change is spread over 3 s, or up to the
  end of the edge if that comes first, and the box is between the two lanes until then
  (`simulation.shown_motion`). Other jumps to the side are spread over 1.5 s.
- Under ``lanechange.duration`` SUMO crashes where a vehicle that is put somewhere leaves its lane
  on a side without another lane, so its lane change is ended first.
- A hand-over from one driver to another begins where the vehicle is (`simulation.ownership`). A
  vehicle that SUMO cannot take for 30 s leaves SUMO's traffic, or is put on the nearest lane of a
  recording's; the rollout says so.
- Vehicles that stand without reaching into the AV's swept way are put on SUMO's ignore lists
  (`log_world.IgnoredVehicles`); a red that the recorded AV itself passes is off.
- Against ``replay`` with logged traffic no vehicle reacts, and an episode is put together without
  SUMO (`simulation.log_only`), equal to the bit to the one with it; searches gain a factor of
  fifty. As a world in the loop of the others it takes 2.5 to 9 times as long as from plan to plan.
- SUMO's traffic is polled (`simulation.road_users`): subscriptions save 0.1 to 0.2 ms of a step
  with 40 to 120 vehicles, and context subscriptions leave out vehicles off every lane.
- SUMO writes into one folder (`simulation.sumo_outputs`): a prefix that leads to / and down again
  catches all outputs; options that do not obey it are refused.
- An AV stays one box, and vehicles that bend never attack: ``moveToXY`` places a front alone.
- Networks without lanes inside junctions get straight ones where there are lights. Priority is read
  from SUMO networks alone: recordings do not state it.
- The user's own SUMO, which SUMO_HOME names, is used instead of the installed package; workers, and
  SUMO's own programs, look there, too (`installed`).

There are two kinds of networks, SUMO's here and the neural ones in `deepmf_sumo.deepmf.networks`.
"""

from deepmf_sumo.sumo import installed

installed.follow()
