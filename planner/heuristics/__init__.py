"""What the way from a node to the goal costs, at least or about."""
