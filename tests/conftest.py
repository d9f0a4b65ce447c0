"""The same surroundings for every test."""

from __future__ import annotations

import os

# MuJoCo loads the GL library that this names when it is imported, and no test in this process
# needs one: those that draw do so in a process of their own.
os.environ["MUJOCO_GL"] = "disable"
