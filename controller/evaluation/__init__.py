"""What measures a policy: batched walks, gait figures, pushes, and the limits of its steps."""
