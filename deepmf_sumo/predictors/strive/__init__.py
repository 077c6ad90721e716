"""The motion prior of STRIVE (Rempe et al., CVPR 2022): a conditional VAE over a graph of agents.

Adapted: encoded lane paths in place of a raster of the map, latents of 16 numbers, one GRU layer,
controls every 0.5 s joined linearly.
"""
