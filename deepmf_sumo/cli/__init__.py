"""Commands: a file each, found by name; no logic."""
