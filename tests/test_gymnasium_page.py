"""The code in docs/gymnasium.md, run as it stands."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "gymnasium.md").read_text(encoding="utf-8")
PIECES = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None,
    reason="stable-baselines3 is not installed: it comes with the extra `test`",
)
@pytest.mark.parametrize("piece", PIECES, ids=["one robot", "many robots"])
def test_stable_baselines3_learns_on_it_for_a_few_updates(piece):
    assert ".learn(total_timesteps=" in piece
    code = f"{piece}\nprint(learner.num_timesteps, learner._n_updates)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    steps, updates = map(int, done.stdout.split())
    assert steps >= 128
    assert updates >= 2
