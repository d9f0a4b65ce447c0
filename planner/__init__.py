"""Footsteps over occupancy grids; see `planner.planner`."""
