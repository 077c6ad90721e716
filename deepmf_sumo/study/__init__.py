"""Specs and plans -> moments -> tasks -> workers -> a result folder.

A run is a pure function of its task: scene, seed, files. So runs can be done by any number of
processes, be resumed, be split into shards or be moved to a Ray cluster, and give the same bytes.
What runs something again (`shrink`, `same_attacks`) is here, too, because it makes tasks.

Why it is as it is:

- Workers use one torch thread each, so that results do not depend on ``--jobs``.
- SUMO passes through a network's traffic once for each worker, not once for each run (`sweep.fork`,
  `deepmf_sumo.sumo.simulation.sumo_config`): it is held shortly before each moment in a copy of the
  worker (``os.fork``), and a copy of that one does the run, to the same bytes. The worker itself
  never starts SUMO on a network: the second SUMO of one process moved vehicles otherwise than the
  first on a real network (Cologne, SUMO 1.28: where objects lie in memory decides between vehicles
  inside a junction; only 1 of 8 moments of a sweep then had the bytes of its run alone, now 8 of
  8). Episodes of a search, and several tries, are done in copies of the run, too. A run is done in
  the worker where a copy would lack something: another system than Linux, a planner with threads.
- A task's key holds digests of what its input files contain (`sweep.inputs`): a resumed sweep
  repeats what changed, wherever the files lie. They are all files that SUMO reads, weights, and of
  a planner or adversary of the user's its package, what that imports from outside the installed
  packages, and files that it names. A planner behind ``http`` is not known.
- Where a sweep runs is an ``Executor``: processes of this machine, or Ray's. Results come home as
  folders, so that nothing else knows the difference. The memory of process trees is code of our
  own: psutil takes 1.2 ms instead of 0.05 ms per look.
- Moments that are drawn by what others found (`moments.promising`) come in batches, so that neither
  workers nor interruptions change what is drawn.
"""
