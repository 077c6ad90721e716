"""The methods that DeepMF is compared with, and the networks that only they need (`priors`).

Each adversary is a file with the contract of `deepmf_sumo.attacks.base`. The room is optional:
nothing imports it but the training of its networks, and without it all else works.
"""
