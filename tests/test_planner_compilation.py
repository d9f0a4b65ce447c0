"""Compiling ahead: nothing is left for the first plan, whoever compiled what."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from planner import compilation
from planner.options import PlannerOptions
from sim.robots import get_robot

# In a process of its own, where nothing is loaded yet.
AHEAD = """
from planner.compilation import _FLOOR, _GOAL, _START, compile_parts
from planner.compiled import FUNCTIONS
from planner.options import PlannerOptions
from planner.planner import Planner
from sim.robots import get_robot

def signatures(names):
    return {(f, str(s)) for f in FUNCTIONS for s in f.signatures if f.py_func.__name__ in names}

model = get_robot("jvrc1").step_model
compile_parts(model, PlannerOptions())
names = {f.py_func.__name__ for f in FUNCTIONS if f.signatures}
ahead = signatures(names)
assert Planner(_FLOOR, model, PlannerOptions()).plan(start=_START, goal=_GOAL).found
print(len(ahead), sorted(signatures(names) - ahead, key=str))
"""


@pytest.mark.slow
def test_parts_are_compiled_as_the_search_needs_them():
    run = subprocess.run([sys.executable, "-c", AHEAD], capture_output=True, text=True, check=True)
    count, missing = run.stdout.strip().split(" ", 1)
    assert int(count) >= 5  # with what these call if it was not in the cache
    assert missing == "[]"


@pytest.mark.slow
@pytest.mark.parametrize("cores", [1, 2])
def test_it_tells_how_far_it_is_and_is_done_once(tmp_path, monkeypatch, cores):
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(compilation, "_cores", lambda: cores)
    model, told = get_robot("jvrc1").step_model, []
    for options in (PlannerOptions(), PlannerOptions()):
        compilation.compile_ahead(model, options, lambda *progress: told.append(progress))
    done, functions, names = zip(*told, strict=True)
    assert list(done) == sorted(done)
    assert set(functions) == {done[-1]}
    assert names[-1] == ""
    assert done.count(done[-1]) == 1
    assert [path.name[:13] for path in tmp_path.iterdir()] == [f"compiled-{PlannerOptions().name}-"]


def test_copied_and_newer_sources_are_told_apart(tmp_path):
    here, copy = tmp_path / "here", tmp_path / "copy"
    here.mkdir()
    source = here / "search.py"
    source.write_text("pass\n")
    shutil.copytree(here, copy)
    taken, age_ns = compilation.numba_takes(here), source.stat().st_mtime_ns
    assert compilation.numba_takes(copy) != taken
    os.utime(source, (1, 1))
    assert compilation.numba_takes(here) != taken
    (here / "notes.txt").touch()
    os.utime(source, ns=(age_ns, age_ns))
    assert compilation.numba_takes(here) == taken
