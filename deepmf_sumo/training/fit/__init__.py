"""The optimisation: loop, schedule, validation, checkpoints."""
