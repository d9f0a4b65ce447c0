"""Compiling ahead: nothing is left for the first plan, whoever compiled what."""

from __future__ import annotations

import subprocess
import sys

import pytest

from planner import compilation
from planner.options import PlannerOptions
from sim.robots import get_robot

# In a process of its own, where nothing is loaded yet.
AHEAD = """
from planner.compilation import _FLOOR, _GOAL, _START
from planner.compiled import FUNCTIONS
from planner.options import PlannerOptions
from planner.planner import Planner
from planner.refinement.refine import compile_refinement
from sim.robots import get_robot

def signatures():
    return {
        (f.py_func.__qualname__, str(s)) for f in FUNCTIONS for s in f.signatures
        if f.py_func.__module__.startswith("planner.refinement.")
    }

model = get_robot("jvrc1").step_model
planner = Planner(_FLOOR, model, PlannerOptions())
compile_refinement(planner.goal_context(_GOAL).lattice, model)
ahead = signatures()
assert planner.plan(start=_START, goal=_GOAL).found
print(len(ahead), sorted(signatures() - ahead))
"""


@pytest.mark.slow
def test_refinement_is_compiled_whole_without_a_search():
    run = subprocess.run([sys.executable, "-c", AHEAD], capture_output=True, text=True, check=True)
    count, missing = run.stdout.strip().split(" ", 1)
    assert int(count) >= 4  # with what these call if it was not in the cache
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
    assert [path.name for path in tmp_path.iterdir()] == [f"compiled-{PlannerOptions().name}"]
