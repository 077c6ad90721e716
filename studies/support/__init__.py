"""What supporters beside the attacker do: which hits need them, and whom they touch."""
