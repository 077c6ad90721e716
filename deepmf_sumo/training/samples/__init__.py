"""Recordings -> features: windows of scenes, samples of each network, their cache."""
