"""Footsteps by way of a path of the body that a sampling planner found."""
