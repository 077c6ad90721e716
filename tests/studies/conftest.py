"""Studies are packages of the repository's top folder, which is not installed."""
