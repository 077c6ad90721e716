"""A network judged without attacks: `screen`, conflicts of plain traffic, and `try` of changes.

These ask what a road and its signals allow, for any SUMO network, with or without an automated
vehicle. They share the places of the risk map, so that findings, conflicts and attacks stand beside
each other. The room is optional: only commands import it.
"""
