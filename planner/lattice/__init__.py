"""The search lattice laid over one map for one goal: its nodes, steps and ends."""
