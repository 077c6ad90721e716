"""How an attack is found. One file an adversary; `base.Adversary` is the contract."""
