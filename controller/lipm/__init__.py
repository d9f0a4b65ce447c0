"""Model-based walking: the same steps, followed by a linear inverted pendulum and no training."""
