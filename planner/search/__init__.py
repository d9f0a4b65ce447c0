"""Searches over the lattice: one request in, one result out."""
