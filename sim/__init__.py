"""The robots and their physics: models, scenes, many simulations at once."""
