"""Scenes -> weights, and how good they are. Optional: nothing but commands imports it.

`recording` makes scenes of SUMO's traffic and `generated` networks for it, `samples` what a network
learns from, `networks` the losses, `fit` the loop, `evaluation` the numbers of a card.

Why so: whoever attacks with the weights of the package needs none of this, so that the package
without torch leaves it out. Training holds out places, not scenes: recordings overlap there, and
scenes of one SUMO run share its traffic. A rollout can be written as a scene (``run --scenes``):
attacks become training data; of such a scene only the AV is a target.
"""
