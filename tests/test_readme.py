"""The README keeps its word: its lines, commands and links are there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from app.cli import COMMANDS
from app.options import parse_options

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
CODE_LINES = [
    line
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    if not language
    for line in block.splitlines()
]


def test_the_two_set_up_lines_stand_word_for_word():
    assert [line for line in CODE_LINES if "pip install" in line] == [
        "python -m pip install -e . && python main.py navigate --map maps/room.png --goal 2,1,1.57",
        "python -m pip install -e '.[test]' && python -m pytest",
    ]


def test_every_command_is_told_of():
    section = README.partition("\n## Commands\n")[2].partition("\n## ")[0]
    told = re.findall(r"^\| `([\w ]+)` \|", section, re.MULTILINE)
    assert sorted(told) == sorted(COMMANDS), "README's table and app/cli.py differ"


def test_every_command_line_is_one_that_is_taken():
    lines = [line.rpartition("python main.py ")[2] for line in CODE_LINES if "main.py " in line]
    assert len(lines) >= 3
    for line in lines:
        name, *words = shlex.split(line)
        if f"{name} {' '.join(words[:1])}" in COMMANDS:
            name, words = f"{name} {words[0]}", words[1:]
        parse_options(COMMANDS[name].load_options(), words, program=name, example="")


@pytest.mark.parametrize(
    "page", ["README.md", *(str(p.relative_to(ROOT)) for p in ROOT.glob("docs/**/*.md"))]
)
def test_every_link_leads_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", text):
        assert (ROOT / page).parent.joinpath(target).exists(), f"{page} links to {target}"


def test_every_file_that_the_readme_names_is_there():
    named = set(re.findall(r"`((?:\w+/)+\w+\.\w+|\w+\.py)`", README)) - {"maps/room.png"}
    assert "app/cli.py" in named
    for name in named:
        assert (ROOT / name).exists(), f"README names {name}"
