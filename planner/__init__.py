"""Footsteps over occupancy grids."""

from planner.compiled import use_cache_of_this_code

use_cache_of_this_code()
