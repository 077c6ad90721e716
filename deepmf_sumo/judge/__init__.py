"""What happened in an episode, and what it is worth.

A verdict is a function of a finished episode: its `Rollout` and its `Case`. Nothing asks how the
attack was found, so that the same motion has the same numbers whichever method drove it.

- Contacts of boxes are found in the loop (``sumo.simulation.contacts.ContactFinder``); what they
  mean is judged here: `metrics` (numbers), `hits` (the words of traffic safety), `ladder` (what a
  hit is worth), `avoidability` (who could have avoided it), `causes` (the smallest change that
  would have).
- What would have happened without the attack is one function, `avoidability.counterfactual`: the
  log where it drives the traffic, else the unattacked episode (``Case.unattacked``, simulated once
  a run before the attack), else keeping lane and speed. Onset, avoidability and naturalness ask it
  alone; it never looks at a plan. Only while a plan is made does a prediction stand in for it
  (`deepmf.constraints`, which asks ``avoidability.grading.avoidable``). A later turn is another
  world than the unattacked episode if an earlier turn moved the AV or the opponent; simulating each
  turn's own episode would take a time that grows with the square of their number.
- A metric is of one episode and one attacker; opponents that take turns or attack together are
  judged one by one, and the row of a run is that of the decisive turn.
"""
