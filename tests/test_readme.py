"""The README keeps its word: its lines, commands and links are there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from app.cli import COMMANDS, load_run
from app.options import parse_options

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    *(str(path.relative_to(ROOT)) for path in sorted(ROOT.glob("docs/**/*.md"))),
]
FOLDERS = "app|benchmarks|controller|docs|examples|maps|planner|sim|tests"
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
        parse_options(load_run(name)[1], words, program=name, example="")


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    if page == "docs/api.md":
        text = ""  # made by a tool, which links every type, also those that are not public
    for target, _, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(#([^)]+))?\)", text):
        path = (ROOT / page).parent / target if target else ROOT / page
        assert path.exists(), f"{page} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)", path.read_text(encoding="utf-8"), re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}
            assert anchor in slugs, f"{page} links to {target}#{anchor}"


@pytest.mark.parametrize("page", PAGES)
def test_every_file_and_module_that_is_named_is_there(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    for name in re.findall(rf"`((?:{FOLDERS})/[\w./-]+|\w+\.py)`", text):
        if "NAME" not in name:
            assert (ROOT / name).exists(), f"{page} names {name}"
    for module in re.findall(rf"python -m ((?:{FOLDERS})\.[\w.]+)", text):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").exists(), f"{page} names python -m {module}"


def test_the_tree_is_the_tree():
    """Every line of the README's tree is a file or folder, and no folder of code is missing."""
    (tree,) = re.findall(r"^```text\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    folder, named = "", set()
    for line in tree.splitlines():
        name = line.split()[0]
        if not line.startswith(" "):
            folder = name if name.endswith("/") else ""
        path = (folder + name if line.startswith(" ") else name).rstrip("/")
        assert (ROOT / path).exists(), f"README's tree has {path}"
        named.add(path)
    packages = ("app", "controller", "maps", "planner", "sim")
    rooms = {p.parent for name in packages for p in (ROOT / name).rglob("*.py")}
    assert {str(room.relative_to(ROOT)) for room in rooms} <= named


def test_the_pages_name_files_and_modules():
    """The rule above sees something: the README's new command, the notes' benchmarks."""
    assert "`app/cli.py`" in README
    measurements = (ROOT / "docs/notes/planner_measurements.md").read_text(encoding="utf-8")
    assert "python -m benchmarks.planner" in measurements
