"""How well a policy walks: what is measured, told and drawn."""
