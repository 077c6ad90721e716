"""Whether generators of scenarios find faults of planners: a good planner, and faulty copies."""
