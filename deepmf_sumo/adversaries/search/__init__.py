"""What searches for attacks share: scouting, the opponent, motion, cost, budget."""
