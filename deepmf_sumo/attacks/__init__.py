"""How an attack is found by episodes: the contract, DeepMF with its tries, a fixed path, none.

An adversary never sees SUMO. It gets ``simulate: Policy -> Rollout`` and a budget, and answers with
an attack. So a search of a hundred episodes and DeepMF with one are compared under the same
conditions, and a method is tested with a function in place of SUMO. `base.Adversary` is the
contract; the methods that DeepMF is compared with are in `deepmf_sumo.baselines`.

Methods that search attack the vehicle that DeepMF would, and know the AV by simulated episodes: the
first is the episode without attack (`_episodes`).
"""
