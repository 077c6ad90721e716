"""A result folder: what a run leaves, how it is written and read, and what is counted of it.

The names and formats of a run's files are here; what runs calls its writers. Everything that counts
runs reads one table, `frames`; all intervals, and what they decide, are `statistics` (the page
computes those of the rows that a person selects again, in its script); what two sides are compared
by is `matching` and `changes`. `gate` makes a verdict of it, `risk` a map.

Why so: two pages that print the same number must have it from the same rows. Results of earlier
versions are completed where they are read (`stored`), so that no other room knows what they
lacked.

- Risk is counted on the network's own places; rates are shrunk towards their mean before they are
  ranked. Places are ranked by criticality, the time that encounters left, within their kind: an
  attacker that may ram from behind does so anywhere, and rates of hits need many times the attacks.
- Moments that were drawn with other chances weigh by their inverse (`statistics.drawn`).
- Units of an interval are independent: the seeds of one spec are one unit.
- One sweep writes into a folder at a time (`folder`). That lock is code of our own: a lock of
  filelock does not name the process that holds it, and does not say where a file system has none.
- Nothing here starts a process or simulates; what repeats runs is in `deepmf_sumo.study`.
"""
