"""The corpus of plans: random problems, the file of their plans, and its check."""
