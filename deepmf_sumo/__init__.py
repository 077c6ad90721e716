"""deepmf-sumo: closed-loop, safety-critical attacks on an automated vehicle in SUMO traffic."""

__version__ = "0.1.0"
