"""A robot file from a published model: what is found by geometry, and what is guessed."""
