"""What drives an opponent, live. One file a policy; `base.Policy` is the contract."""
