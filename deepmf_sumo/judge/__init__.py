"""What happened in an episode, and what it is worth.

Everything here is a function of a finished episode: its `Rollout` and its `Case`. Nothing asks how
the attack was found, so that the same motion has the same numbers whichever method drove it.
"""
