"""A result folder: what a run leaves, how it is written, read, and which quantities it has."""
