"""The parts of one DeepMF plan: limits and tracking, goals, candidates, collision, selection."""
