"""The command `compare`: logs of robots read, replayed, told and drawn."""
