"""Whether feet and body are clear of the map, and what ground is under them."""
