"""Long studies are not run by the tests: what they take from this project must exist all the same."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

import afdsvc

BENCHMARKS = Path(afdsvc.__file__).parents[1] / "benchmarks"


def taken(file: Path) -> Iterator[tuple[ModuleType | Path, str]]:
    """Yield every name that a file takes from a module of the package or from a file beside it."""
    tree, modules = ast.parse(file.read_text(encoding="utf-8")), dict[str, ModuleType]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            beside = file.parent / f"{node.module}.py"
            if node.module.partition(".")[0] == "afdsvc":
                module = importlib.import_module(node.module)
                for alias in node.names:
                    if hasattr(module, "__path__") and find_spec(f"{module.__name__}.{alias.name}"):
                        importlib.import_module(f"{module.__name__}.{alias.name}")
                    yield module, alias.name
                    if isinstance(value := getattr(module, alias.name, None), ModuleType):
                        modules[alias.asname or alias.name] = value
            elif beside.exists():
                yield from ((beside, alias.name) for alias in node.names)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            yield modules[node.value.id], node.attr


def defined(file: Path) -> set[str]:
    """Return the names that a file binds anywhere."""
    nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    bound = {n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.ClassDef)} | {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return bound | {a.asname or a.name for n in nodes if isinstance(n, ast.Import | ast.ImportFrom) for a in n.names}


@pytest.mark.parametrize("file", sorted(BENCHMARKS.rglob("*.py")), ids=lambda f: str(f.relative_to(BENCHMARKS)))
def test_what_a_benchmark_takes_from_this_project_exists(file):
    missing = [f"{of}.{name}" for of, name in taken(file) if not (name in defined(of) if isinstance(of, Path) else hasattr(of, name))]
    assert missing == []
