"""Compiled code never outlives the source that it was made from."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import planner

CALLEE = "from numba import njit\n\n\n@njit(cache=True)\ndef value():\n    return {}\n"
CALLER = (
    "from numba import njit\n\nfrom planner.callee import value\n\n\n"
    "@njit(cache=True)\ndef twice():\n    return 2 * value()\n"
)


@pytest.fixture
def sources(tmp_path):
    """A folder with a package `planner` of which two functions are compiled."""
    folder = tmp_path / "planner"
    folder.mkdir()
    (folder / "__init__.py").write_text(Path(planner.__file__).read_text())
    (folder / "callee.py").write_text(CALLEE.format(1))
    (folder / "caller.py").write_text(CALLER)
    return folder


def twice(sources: Path) -> str:
    """What the compiled function of the package says in a process of its own."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    return subprocess.run(
        [sys.executable, "-c", "from planner.caller import twice; print(twice())"],
        cwd=sources.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def test_a_changed_callee_in_another_file_is_compiled_anew(sources):
    for number in (1, 2):
        (sources / "callee.py").write_text(CALLEE.format(number))
        assert twice(sources) == str(2 * number)


def test_caches_of_other_sources_go_once_they_are_old_and_nothing_else_does(sources):
    caches = sources / "__pycache__"
    old, used, young = (caches / f"numba-{name}" for name in ("old", "used", "young"))
    others = caches / "numbers", caches / "numba.txt"
    for folder in (old, used, young, others[0]):
        (folder / "part").mkdir(parents=True)
        (folder / "part" / "code.nbc").write_text("")
    others[1].write_text("")
    two_days_ago = time.time() - 2 * 24 * 3600
    for path in caches.rglob("*"):
        # Of `used` one file was written just now.
        if path.is_relative_to(young) or path == used / "part" / "code.nbc":
            continue
        os.utime(path, (two_days_ago, two_days_ago))
    assert twice(sources) == "2"
    assert not old.exists()
    for kept in (used, young, *others):
        assert kept.exists()
    # The cache of these sources is there now, and is left alone however old it is.
    (own,) = set(caches.glob("numba-*")) - {used, young}
    for path in (own, *own.rglob("*")):
        os.utime(path, (two_days_ago, two_days_ago))
    assert twice(sources) == "2"
    assert own.exists()
