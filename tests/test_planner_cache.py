"""Compiled code never outlives the source that it was made from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import planner

CALLEE = "from numba import njit\n\n\n@njit(cache=True)\ndef value():\n    return {}\n"
CALLER = (
    "from numba import njit\n\nfrom planner.callee import value\n\n\n"
    "@njit(cache=True)\ndef twice():\n    return 2 * value()\n"
)


def test_a_changed_callee_in_another_file_is_compiled_anew(tmp_path):
    folder = tmp_path / "planner"
    folder.mkdir()
    for name in ("__init__.py", "compiled.py"):
        (folder / name).write_text((Path(planner.__file__).parent / name).read_text())
    (folder / "caller.py").write_text(CALLER)
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    for number in (1, 2):
        (folder / "callee.py").write_text(CALLEE.format(number))
        said = subprocess.run(
            [sys.executable, "-c", "from planner.caller import twice; print(twice())"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert said.stdout.strip() == str(2 * number)
