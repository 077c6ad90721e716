"""Commands: a file each, found by name; no logic.

A command reads options, calls one function of another room and shows what it returned. Modules that
begin with ``_`` are shared by several commands. ``--help`` must be quick, so that a command imports
what it calls only when it is called.
"""
