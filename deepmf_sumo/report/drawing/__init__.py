"""What pictures and figures share: roads, boxes of vehicles, the part of the world that is seen."""
