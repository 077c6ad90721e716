"""What drives the AV. One file a planner; `base.Planner` is the contract."""
