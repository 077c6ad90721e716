"""Planners that are not a Python class: how views go out, commands come in, and what is refused."""
