"""The loop of planning, walking and planning again, and its report."""
