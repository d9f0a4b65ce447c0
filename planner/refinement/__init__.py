"""Plans moved off the lattice to where they cost least."""
