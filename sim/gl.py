"""The GL library that MuJoCo draws with: found without a display, or switched off."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

NO_GL = (
    "pictures and films of the robot need a GL library and none works here: "
    "apt-get install libegl1 libgl1-mesa-dri (or libosmesa6)"
)
# What MUJOCO_GL may say for no rendering at all.
_OFF = ("disable", "disabled", "off", "false", "0")
_PROBE = "import mujoco; mujoco.GLContext(16, 16).make_current()"


class NoGlError(RuntimeError):
    """No GL library works here; the message names the packages that help."""

    def __init__(self) -> None:
        super().__init__(NO_GL)


def prepare_gl() -> str:
    """Finds a way to render without a display and sets MUJOCO_GL to it; returns its name.

    MuJoCo reads the variable when it is first imported, so this comes before that. Each way is
    tried in a process of its own (half a second), because a GL library that is only half
    installed can take the process down. What MUJOCO_GL says already is tried first.

    Raises:
        NoGlError: None works; rendering is switched off then.
    """
    given = os.environ.get("MUJOCO_GL", "").lower()
    ways = ["egl", "osmesa"] if platform.system() == "Linux" else [""]
    if given and given not in _OFF:
        ways = [given, *ways]
    for way in dict.fromkeys(ways):
        environment = {**os.environ, "MUJOCO_GL": way}
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, check=False
        )
        if probe.returncode == 0:
            os.environ["MUJOCO_GL"] = way
            return way
    switch_gl_off()
    raise NoGlError


def switch_gl_off() -> None:
    """Lets MuJoCo be imported whatever MUJOCO_GL says.

    MuJoCo loads the library that the variable names even if nothing is drawn, and cannot be
    imported where that library is missing. Call this before its import.
    """
    os.environ["MUJOCO_GL"] = "disable"
