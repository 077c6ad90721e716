"""What each network minimises, and what is fitted after its training."""
