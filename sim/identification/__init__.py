"""Servo parameters of a robot from a log of how it moved."""
