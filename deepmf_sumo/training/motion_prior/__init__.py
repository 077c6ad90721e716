"""Training of STRIVE's motion prior."""
