"""A sweep: tasks in, a result folder out; worker processes, resume, shards, a Ray cluster."""
