"""The measures of the package's structure: sizes, importers, names, cycles, functions, state, constants; from its text alone.

    python benchmarks/structure/measure.py [CHECKOUT]

Nothing of the package is imported, so any checkout will do. *Lines* are all lines of a file. *Importers* of a module are the modules whose
text names it in an import, at the top or in a function. A *body* is the lines of a function below its signature and docstring, functions inside
it included.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PURE = ("detect", "excite", "identify", "explain", "gap", "lti")  # rooms of arrays in, arrays out ("gap" became "explain")
CONTAINERS = {"dict", "list", "set", "deque", "defaultdict", "OrderedDict", "Counter", "WeakKeyDictionary", "WeakValueDictionary"}
CACHES = {"lru_cache", "cache"}
WRITING = {"add", "append", "appendleft", "clear", "discard", "extend", "insert", "pop", "popitem", "popleft", "remove", "setdefault", "update"}
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """One file of the package: its dotted name, path, lines and syntax tree."""

    name: str
    path: Path
    lines: int
    tree: ast.Module

    @property
    def package(self) -> str:
        """The package relative imports start from."""
        return self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]

    @property
    def room(self) -> str:
        """The folder or file at the top of the package."""
        return [*self.name.split("."), "(top)"][1]


def modules(root: Path) -> dict[str, Module]:
    """Return the modules of a package by name; generated ones count as lines and nothing else."""
    found = {}
    for path in sorted(root.rglob("*.py")):
        name = ".".join((root.name, *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
        text = path.read_text(encoding="utf-8")
        tree = ast.Module([], []) if name.endswith("_pb2") else ast.parse(text, str(path))
        found[name] = Module(name, path, text.count("\n"), tree)
    return found


def imported(module: Module, known: dict[str, Module]) -> set[str]:
    """Return the modules of the package that a module's text imports."""
    found = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*module.package.split(".")[: len(module.package.split(".")) - node.level + 1], *filter(None, [base])])
            found |= {f"{base}.{a.name}" if f"{base}.{a.name}" in known else base for a in node.names}
    return (found & known.keys()) - {module.name}


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the sets of modules that import each other in a circle (Tarjan's strongly connected components)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            at = stack.index(name)
            found.append(sorted(stack[at:]))
            del stack[at:]

    for name in graph:
        if name not in index:
            visit(name)
    return [c for c in found if len(c) > 1]


def functions(tree: ast.Module) -> Iterator[Function]:
    """Yield every function and method."""
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def body_lines(function: Function) -> int:
    """Return the lines below signature and docstring, 0 when there are none."""
    body = function.body[1:] if ast.get_docstring(function, clean=False) is not None else function.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def assigned(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Yield (name, value) of what is assigned at the top of a module, a tuple of values one by one."""
    for node in tree.body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            yield from zip(map(ast.unparse, target.elts), node.value.elts, strict=True)
        else:
            yield ast.unparse(target), node.value


def numbers(tree: ast.Module) -> int:
    """Return how many numbers stand in what is assigned at the top of a module, in tables and expressions too."""
    return sum(is_number(n) for _, value in assigned(tree) for n in ast.walk(value) if isinstance(n, ast.Constant))


def is_number(value: ast.expr) -> bool:
    """Whether an expression is made of numbers alone."""
    if isinstance(value, ast.UnaryOp | ast.BinOp):
        return all(is_number(v) for v in ast.iter_child_nodes(value) if isinstance(v, ast.expr))
    return isinstance(value, ast.Constant) and isinstance(value.value, int | float) and not isinstance(value.value, bool)


def called(node: ast.AST) -> str:
    """Return the last name of what is called or named: ``functools.lru_cache(8)`` is ``lru_cache``."""
    target = node.func if isinstance(node, ast.Call) else node
    return target.attr if isinstance(target, ast.Attribute) else target.id if isinstance(target, ast.Name) else ""


def written(node: ast.AST) -> Iterator[ast.expr]:
    """Yield the expressions whose object a statement changes: by item, by a mutating method, by +=."""
    targets = node.targets if isinstance(node, ast.Assign | ast.Delete) else [node.target] if isinstance(node, ast.AugAssign | ast.AnnAssign) else []
    for target in targets:
        if isinstance(target, ast.Subscript):
            yield target.value
        elif isinstance(node, ast.AugAssign):
            yield target
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in WRITING:
        yield node.func.value


def changed_names(tree: ast.Module) -> set[str]:
    """Return the names whose object a function of the module changes, or that it rebinds (``global``)."""
    found = set()
    for function in functions(tree):
        for node in ast.walk(function):
            found |= {e.id for e in written(node) if isinstance(e, ast.Name)}
            found |= set(node.names) if isinstance(node, ast.Global) else set()
    return found


def remembering(known: dict[str, Module]) -> set[str]:
    """Return the classes whose methods, after construction, change their own object."""
    found = set()
    for node in (n for m in known.values() for n in ast.walk(m.tree) if isinstance(n, ast.ClassDef)):
        for method in (f for f in node.body if isinstance(f, Function) and f.name not in ("__init__", "__post_init__")):
            for inner in ast.walk(method):
                targets = inner.targets if isinstance(inner, ast.Assign) else []
                if any(of_self(e) for e in (*targets, *written(inner))):
                    found.add(node.name)
    return found


def of_self(value: ast.expr) -> bool:
    """Whether an expression is an attribute of ``self``."""
    return isinstance(value, ast.Attribute) and isinstance(value.value, ast.Name) and value.value.id == "self"


def state(module: Module, classes: set[str]) -> list[str]:
    """Return the module's mutable state: containers that are changed, weak dictionaries, caches, objects that remember."""
    changed, found = changed_names(module.tree), []
    for name, value in assigned(module.tree):
        kind = called(value) if isinstance(value, ast.Call) else type(value).__name__.lower().removesuffix("comp")
        weak = kind.startswith("Weak") or kind in CACHES
        if weak or kind in classes - CONTAINERS or (name in changed and (kind in CONTAINERS or not isinstance(value, ast.Call))):
            found.append(f"{name} ({kind})")
    return found + [f"{f.name} ({called(d)})" for f in functions(module.tree) for d in f.decorator_list if called(d) in CACHES]


def defined(tree: ast.Module) -> set[str]:
    """Return the public classes and functions of a module."""
    return {node.name for node in tree.body if isinstance(node, Function | ast.ClassDef) and not node.name.startswith("_")}


def at(values: list[int], share: float) -> int:
    """Return a quantile of whole numbers: the smallest that at least this share of them do not exceed."""
    ordered = sorted(values)
    return ordered[max(0, -int(-share * len(ordered) // 1) - 1)]


def show(title: str, items: list[str], most: int | None = None) -> None:
    """Print a title and items below it."""
    print(f"\n{title}")
    for item in items[:most]:
        print(f"  {item}")


def sizes(root: Path, known: dict[str, Module]) -> None:
    """Print files, lines, flat folders, functions."""
    top = [p.name for p in root.iterdir() if p.name not in ("__pycache__", "__init__.py", "py.typed")]
    folders = Counter(str(m.path.parent.relative_to(root.parent)) for m in known.values())
    bodies = [body_lines(f) for m in known.values() for f in functions(m.tree)]
    lengths = [m.lines for m in known.values()]
    print(f"modules in the wheel                 {len(known)}")
    print(f"lines in the wheel                   {sum(lengths)}")
    print(f"entries at the top of {root.name:<15}{len(top)}")
    print(f"file length median, p90, most        {at(lengths, 0.5)}, {at(lengths, 0.9)}, {max(lengths)}")
    print(f"functions                            {len(bodies)}")
    print(f"body of a function median, p90, p99  {at(bodies, 0.5)}, {at(bodies, 0.9)}, {at(bodies, 0.99)}")
    show("Largest flat folders (modules)", [f"{n:3d} {folder}" for folder, n in folders.most_common()], 12)


def links(known: dict[str, Module]) -> None:
    """Print importers and cycles."""
    graph = {name: imported(m, known) for name, m in known.items()}
    importers = Counter(other for names in graph.values() for other in names)
    single = [m for m in known.values() if importers[m.name] == 1]
    print(f"\nmodules with one importer            {len(single)}, of them {sum(m.lines < 80 for m in single)} below 80 lines")
    found = cycles(graph)
    show(f"Import cycles, imports in functions included: {len(found)}", [", ".join(c) for c in found])


def names(known: dict[str, Module]) -> None:
    """Print public names that more than one module defines."""
    homes = defaultdict(list)
    for module in known.values():
        for name in defined(module.tree):
            homes[name].append(module.name.partition(".")[2])
    twice = {n: where for n, where in sorted(homes.items(), key=lambda item: (-len(item[1]), item[0])) if len(where) > 1}
    hooks = {n for n in twice if n.startswith("afdsvc_")}
    title = f"Public classes and functions defined in more than one module: {len(twice)}, of them {len(hooks)} plugin hooks"
    show(title, [f"{len(where)} {name}: {', '.join(where)}" for name, where in twice.items()])


def kept(known: dict[str, Module]) -> None:
    """Print mutable state at the top of modules of the pure rooms, and numeric constants by room."""
    classes = remembering(known)
    found = [(m.name, s) for m in known.values() if m.room in PURE for s in state(m, classes)]
    show(f"Mutable state at the top of modules in {', '.join(PURE)}: {len(found)}", [f"{name}: {s}" for name, s in found])
    constants = Counter(m.room for m in known.values() for _, value in assigned(m.tree) if is_number(value))
    tables: Counter[str] = Counter()
    for module in known.values():
        tables[module.room] += numbers(module.tree)
    title = f"Numeric constants at the top of modules: {sum(constants.values())}; numbers in all values there, tables included: {sum(tables.values())}"
    show(title, [f"{constants[room]:3d} {n:4d} {room}" for room, n in sorted(tables.items(), key=lambda item: -constants[item[0]]) if n])


def main() -> None:
    """Print all measures of the package in a checkout (this one unless another is named)."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[2]) / "afdsvc"
    known = modules(root)
    sizes(root, known)
    links(known)
    names(known)
    kept(known)


if __name__ == "__main__":
    main()
