"""Holds the table of who may import whom, and keeps heavy libraries out of quick commands."""

from __future__ import annotations

import ast
import graphlib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("maps", "planner", "sim", "controller", "app")

# Package -> modules of the house it may import; a name covers everything below it.
MAY_IMPORT = {
    "maps": ("maps",),
    "planner": ("planner", "maps"),
    "sim": ("sim", "maps", "planner.robot_model"),
    "controller": (
        *("controller", "maps", "sim"),
        *("planner.robot_model", "planner.plan", "planner.corpus.corpus"),
    ),
    "app": PACKAGES,
}

# Room of the planner -> what it may import of the planner, besides itself.
_BASE = (
    *("cache", "compiled", "robot_model", "plan", "options", "time_limit"),
    "collision",
)
PLANNER_ROOMS = {
    "lattice": _BASE,
    "heuristics": (*_BASE, "lattice"),
    "search": (*_BASE, "lattice", "heuristics"),
    "refinement": (*_BASE, "lattice", "search"),
    "sampling": (*_BASE, "lattice", "heuristics", "search"),
    "corpus": (*_BASE, "planner", "endpoints", "verify"),
}

# Heavy library -> packages that may import it at all.
MAY_LOAD = {
    "mujoco": ("sim", "controller", "app"),
    "pydrake": ("sim",),
    "torch": ("controller", "app"),
    "rsl_rl": ("controller", "app"),
    "gymnasium": ("controller",),
    "onnx": ("controller",),
    "tensordict": ("controller", "app"),
    "ompl": ("planner",),
    "numba": ("planner",),
    "mink": ("controller",),
    "daqp": ("controller",),
    "cv2": ("maps", "planner", "app"),
    "shapely": ("maps", "planner"),
    "matplotlib": ("app",),
    "av": ("app",),
    "tyro": ("app",),
    "rich": ("app",),
    "mcap": ("app",),
    "rosbags": ("app",),
    "cyclonedds": ("app",),
    "ray": ("app",),
    "rospy": ("app",),
}


def imports(tree: ast.AST) -> Iterator[str]:
    """Full names of the modules that a file imports, in functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "house imports are absolute"
            assert node.module is not None
            # `from planner import plan` imports planner.plan; `from planner.plan import Pose`
            # imports planner.plan too, and the longer name lies below it.
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def covered(name: str, allowed: tuple[str, ...]) -> bool:
    return any(name == module or name.startswith(f"{module}.") for module in allowed)


def files_of(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def name_of(path: Path) -> str:
    """The name by which a file is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_what_the_table_allows(package):
    files = files_of(package)
    assert files
    for path in files:
        for name in imports(ast.parse(path.read_text(encoding="utf-8"))):
            if covered(name, PACKAGES):
                assert covered(name, MAY_IMPORT[package]), f"{path} imports {name}"


def test_every_room_of_the_planner_is_in_the_table():
    folders = {path.parent.name for path in (ROOT / "planner").glob("*/*.py")}
    assert folders == set(PLANNER_ROOMS)


@pytest.mark.parametrize("room", PLANNER_ROOMS)
def test_rooms_of_the_planner_import_only_what_lies_below_them(room):
    allowed = tuple(f"planner.{name}" for name in (room, *PLANNER_ROOMS[room]))
    files = files_of(f"planner/{room}")
    assert len(files) > 1
    for path in files:
        for name in imports(ast.parse(path.read_text(encoding="utf-8"))):
            if covered(name, ("planner",)):
                assert covered(name, allowed), f"{path} imports {name}"


def test_no_file_imports_itself_by_way_of_others():
    names = {name_of(path): path for package in PACKAGES for path in files_of(package)}
    graph = {
        name: {
            module
            for imported in imports(ast.parse(path.read_text(encoding="utf-8")))
            for module in (imported, imported.rpartition(".")[0])
            if module in names and module != name
        }
        for name, path in names.items()
    }
    # The packages themselves import nothing: their files are what counts.
    tuple(graphlib.TopologicalSorter(graph).static_order())


def test_no_test_file_imports_another():
    """What several of them use is in a helper's file."""
    files = sorted((ROOT / "tests").glob("*.py"))
    assert len(files) > 50
    for path in files:
        for name in imports(ast.parse(path.read_text(encoding="utf-8"))):
            assert not name.startswith("tests.test_"), f"{path} imports {name}"


@pytest.mark.parametrize("package", PACKAGES)
def test_heavy_libraries_stay_where_they_belong(package):
    for path in files_of(package):
        for name in imports(ast.parse(path.read_text(encoding="utf-8"))):
            library = name.partition(".")[0]
            allowed = MAY_LOAD.get(library, PACKAGES)
            assert package in allowed, f"{path} imports {library}"


def test_main_imports_only_app():
    names = list(imports(ast.parse((ROOT / "main.py").read_text(encoding="utf-8"))))
    house = [name for name in names if covered(name, PACKAGES)]
    assert house == ["app.cli.main"]


def test_the_rule_sees_what_it_should():
    source = "def f():\n    from sim import scene\n    import torch.nn"
    assert list(imports(ast.parse(source))) == ["sim.scene", "torch.nn"]
    assert covered("planner.robot_model.Side", MAY_IMPORT["sim"])
    assert not covered("planner.plan.FootstepPlan", MAY_IMPORT["sim"])
    assert not covered("simulate", ("sim",))


@pytest.mark.parametrize("package", PACKAGES)
def test_files_stay_readable(package):
    for path in files_of(package):
        lines = path.read_text(encoding="utf-8").count("\n")
        assert lines <= 450, f"{path} has {lines} lines: perhaps two ideas in one file"
