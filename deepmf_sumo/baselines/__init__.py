"""The methods that DeepMF is compared with, and the networks that only they need (`priors`).

Each adversary is a file with the contract of `deepmf_sumo.attacks.base`. The room is optional:
nothing imports it but the training of its networks, and without it all else works.

They are ours after their papers, not the authors' code: each file says what it follows and what was
adapted. What several share lies beside them in modules that begin with ``_``.
"""
