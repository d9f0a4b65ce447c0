"""Pictures and films of plans, walks and corpora."""
