"""Specs and plans -> moments -> tasks -> workers -> a result folder.

A run is a pure function of its task: scene, seed, files. So runs can be done by any number of
processes, be resumed, be split into shards or be moved to a Ray cluster, and give the same bytes.
What runs something again (`shrink`, `same_attacks`) is here, too, because it makes tasks.
"""
