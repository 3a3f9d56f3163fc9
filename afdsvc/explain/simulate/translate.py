"""Python code of a simulator rewritten so that numba compiles it: parameters by number, results into an array."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Sequence
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import overload


class Untranslatable(Exception):
    """Code that cannot be compiled, with the reason."""


def translated(function: Callable[..., Any], names: Sequence[str], size: int) -> Any:
    """Return ``function(t, x, u, p)``, which gives ``size`` values, as a compiled function ``(t, x, u, p, out)`` of arrays.

    ``p["name"]`` and ``p.name`` become entries of the array in the order of ``names``; returned values are written to ``out``.
    Constants and methods of the object and helper functions of the same module are taken over as they are now. Raises
    `Untranslatable` where the source is unknown; what numba refuses it refuses at the first call.
    """
    return _Translation(names).compiled(function, size)


class _Translation:
    """The functions of one simulator; each helper is compiled once."""

    def __init__(self, names: Sequence[str]) -> None:
        self.numbers = {name: k for k, name in enumerate(names)}
        self.done: dict[object, Any] = {}

    def compiled(self, function: Callable[..., Any], size: int = 0) -> Any:
        """Return the compiled function; with a ``size`` its result goes to a last argument ``out``."""
        function = getattr(function, "py_func", function)
        if function not in self.done:
            self.done[function] = None  # a call of itself is left to numba, which refuses it
            self.done[function] = self._compile(function, size)
        return self.done[function]

    def _compile(self, function: Callable[..., Any], size: int) -> Any:
        plain, owner = getattr(function, "__func__", function), getattr(function, "__self__", None)
        tree = _source(plain)
        scope = {**plain.__globals__, **inspect.getclosurevars(plain).nonlocals, "_store": store, "_changed": changed}
        known: dict[str, Any] = {}
        arguments = [a.arg for a in tree.args.args]
        if owner is not None:
            known[arguments.pop(0)] = owner
            tree.args.args.pop(0)
        if size and len(arguments) != 4:
            raise Untranslatable(f"{plain.__qualname__} takes {len(arguments)} arguments instead of t, x, u, p")
        rewriter = _Rewriter(self, scope, known, arguments, size)
        body = [rewriter.visit(statement) for statement in tree.body]
        tree.body = [line for part in body for line in (part if isinstance(part, list) else [part])]
        tree.decorator_list, tree.returns = [], None
        if size:
            tree.args.args.append(ast.arg("_out"))
        for a in tree.args.args:
            a.annotation = None
        code = compile(ast.fix_missing_locations(ast.Module([tree], [])), f"<{plain.__qualname__}>", "exec")
        exec(code, scope)
        return njit(error_model="numpy", nogil=True)(scope[tree.name])


class _Rewriter(ast.NodeTransformer):
    """Rewrites one function: parameters, constants of objects, helper functions, unpacking, results."""

    def __init__(
        self, translation: _Translation, scope: dict[str, Any], known: dict[str, Any], arguments: Sequence[str], size: int
    ) -> None:
        self.translation, self.scope, self.known, self.arguments, self.size = translation, scope, known, arguments, size
        self.parameters = arguments[-1] if size else "p"

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        return node  # a function inside has results of its own

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        key = node.slice.value if isinstance(node.slice, ast.Constant) else None
        if isinstance(node.value, ast.Name) and isinstance(key, str) and self._local(node.value.id):
            return self._number(node, node.value.id, key)
        return self._constant(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name) and node.value.id == self.parameters and node.attr in self.translation.numbers:
            return self._number(node, node.value.id, node.attr)
        return self._constant(node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        """Rewrite ``p | {"name": value}``, a copy of the parameters with others in their place."""
        others = node.right
        if not (isinstance(node.op, ast.BitOr) and isinstance(others, ast.Dict) and isinstance(node.left, ast.Name) and node.left.id == self.parameters):
            return self.generic_visit(node)
        found: ast.expr = node.left
        for key, value in zip(others.keys, others.values, strict=True):
            name = key.value if isinstance(key, ast.Constant) else None
            if name not in self.translation.numbers:
                raise Untranslatable(f"parameter {name!r} is not among those of the model")
            number = ast.Constant(self.translation.numbers[name])
            found = ast.Call(ast.Name("_changed", ast.Load()), [found, number, self.visit(value)], [])
        return found

    def visit_Name(self, node: ast.Name) -> ast.AST:
        return self._constant(node) if isinstance(node.ctx, ast.Load) else node

    def visit_Assign(self, node: ast.Assign) -> Any:
        target = node.targets[0]
        if len(node.targets) > 1 or not isinstance(target, ast.Tuple | ast.List) or isinstance(node.value, ast.Tuple | ast.List):
            return self.generic_visit(node)
        hold = ast.Assign([ast.Name("_parts", ast.Store())], self.visit(node.value))
        parts = [
            ast.Assign([part], ast.Subscript(ast.Name("_parts", ast.Load()), ast.Constant(k), ast.Load()))
            for k, part in enumerate(target.elts)
        ]
        return [ast.copy_location(line, node) for line in (hold, *parts)]

    def visit_Return(self, node: ast.Return) -> Any:
        if not self.size or node.value is None:
            return self.generic_visit(node)
        values = _elements(node.value)
        if values is None:
            call = ast.Call(ast.Name("_store", ast.Load()), [ast.Name("_out", ast.Load()), self.visit(node.value)], [])
            return [ast.copy_location(ast.Expr(call), node), ast.copy_location(ast.Return(None), node)]
        if len(values) != self.size:
            raise Untranslatable(f"{len(values)} values are returned instead of {self.size}")
        lines: list[ast.stmt] = [
            ast.Assign([ast.Subscript(ast.Name("_out", ast.Load()), ast.Constant(k), ast.Store())], self.visit(value))
            for k, value in enumerate(values)
        ]
        return [ast.copy_location(line, node) for line in (*lines, ast.Return(None))]

    def _local(self, name: str) -> bool:
        return name not in self.known and (name in self.arguments or name not in self.scope)

    def _number(self, node: ast.expr, name: str, key: str) -> ast.AST:
        if key not in self.translation.numbers:
            raise Untranslatable(f"parameter '{key}' is not among those of the model")
        return ast.Subscript(ast.Name(name, ast.Load()), ast.Constant(self.translation.numbers[key]), ast.Load())

    def _constant(self, node: ast.expr) -> ast.AST:
        """Replace what is known now, such as ``self.mass`` or a helper function, by a global of its own."""
        try:
            value = self._value(node)
        except LookupError:
            return self.generic_visit(node)
        if isinstance(value, FunctionType) or (callable(value) and hasattr(value, "__func__")) or hasattr(value, "py_func"):
            value = self.translation.compiled(value)
        elif isinstance(node, ast.Name) and not isinstance(value, list):
            return node
        elif isinstance(value, list):
            value = np.array(value, dtype=np.float64)
        elif not isinstance(value, bool | int | float | np.ndarray | np.generic | tuple):
            return self.generic_visit(node)
        name = f"_known_{len(self.scope)}"
        self.scope[name] = value
        return ast.Name(name, ast.Load())

    def _value(self, node: ast.expr) -> Any:
        """Return what an expression of names, attributes and constant subscripts stands for; `LookupError` when unknown."""
        if isinstance(node, ast.Name):
            if self._local(node.id):
                raise LookupError(node.id)
            return self.known[node.id] if node.id in self.known else self.scope[node.id]
        if isinstance(node, ast.Attribute):
            owner = self._value(node.value)
            if isinstance(owner, ModuleType | np.ndarray) or not hasattr(owner, node.attr):
                raise LookupError(node.attr)  # numba knows modules and arrays
            return getattr(owner, node.attr)
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
            owner = self._value(node.value)
            if not isinstance(owner, dict):
                raise LookupError
            return owner[node.slice.value]
        raise LookupError


def _source(function: Any) -> ast.FunctionDef:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    except (OSError, TypeError, SyntaxError) as error:
        raise Untranslatable("its source is not available") from error
    if not isinstance(tree, ast.FunctionDef):
        raise Untranslatable("it is not a plain function")
    return tree


def _elements(node: ast.expr) -> list[ast.expr] | None:
    """Return the elements of a returned list, tuple or ``np.array([...])``; None for anything else."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in ("array", "asarray") and node.args:
        node = node.args[0]
    if isinstance(node, ast.List | ast.Tuple) and not any(isinstance(e, ast.Starred | ast.List | ast.Tuple) for e in node.elts):
        return node.elts
    return None


@njit(error_model="numpy", nogil=True)
def changed(values, number, value):  # type: ignore[no-untyped-def]
    """Return a copy of numbers with one other."""
    found = values.copy()
    found[number] = value
    return found


def store(out: Any, values: Any) -> None:
    """Write a number or a sequence into ``out`` (compiled code only)."""


@overload(store)
def _store(out, values):  # type: ignore[no-untyped-def]
    if isinstance(values, types.Number | types.Boolean):

        def one(out, values):  # type: ignore[no-untyped-def]
            out[0] = values

        return one

    def many(out, values):  # type: ignore[no-untyped-def]
        for k in range(len(out)):
            out[k] = values[k]

    return many
