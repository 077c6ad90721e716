"""Policies, which drive an opponent step by step. One file each; `base.Policy` is the contract."""
