"""DeepMF: what an attack considers, how it chooses, and how it is driven."""
