"""Changes what mutmut leaves alone, one place at a time, and asks whether the unit tests notice.

mutmut changes the bodies of plain functions. The transition table, the gate's tables of allowed motions and requests,
constants, and the bodies of decorated functions (properties, cached ones) come into being at import and are not changed
by it. Here they are: an entry of a table is left out, a member of an enumeration becomes another one, a number grows by
one, a comparison or an operator becomes its neighbour. Each change is tried in a process of its own, forked from one
that has imported the libraries already.

    python tests/mutation/at_import.py [MODULE...]

prints the survivors of each module, then how many of its changes were noticed; exits with 1 if any survived.
"""

from __future__ import annotations

import ast
import importlib.abc
import importlib.util
import os
import signal
import sys
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, ModuleType

import cantools
import hypothesis
import numpy as np
import pytest
import scipy.spatial.transform

LIBRARIES = (cantools, hypothesis, np, scipy.spatial.transform)
"""Imported once, before any fork."""
TESTS = {
    "controller/states.py": ("states",),
    "controller/safety.py": ("safety", "safety_limits"),
    "controller/situation.py": ("safety", "safety_limits"),
    "drivers/arm/rtde_stream.py": ("arm_wire",),
    "drivers/charger/e2e.py": ("e2e",),
    "drivers/charger/messages.py": ("charger_messages", "charger_fd"),
    "drivers/scanner/checksums.py": ("scanner_checksums",),
    "drivers/scanner/frame_parser.py": ("scanner_frame_counts", "scanner_frames"),
    "drivers/scanner/profiler2_codec.py": ("scanner_profiler2_packets", "scanner_profiler2_literal"),
    "drivers/scanner/scip_codec.py": ("scanner_scip_replies", "scanner_scip_literal", "scanner_scip_codec"),
}
"""Module -> the unit tests that are to notice; those of ``[tool.mutmut]``. frame_decode.py has nothing at import."""
PATIENCE_S = 120
NEIGHBOUR: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitAnd, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
}  # fmt: skip


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Hands out the changed code for one module's name."""

    def __init__(self, name: str, path: Path, code: CodeType) -> None:
        self.name, self.path, self.code = name, path, code

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(self.path))

    def exec_module(self, module: ModuleType) -> None:
        exec(self.code, module.__dict__)


def left_alone(body: list[ast.stmt]) -> Iterator[ast.AST]:
    """The statements of a module or class that mutmut does not change: all but its plain functions and the imports."""
    for statement in body:
        if isinstance(statement, ast.ClassDef):
            yield from left_alone(statement.body)
        elif isinstance(statement, ast.FunctionDef):
            if statement.decorator_list:
                yield from (inner for inner in statement.body if not _is_docstring(inner))
        elif not isinstance(statement, ast.Import | ast.ImportFrom) and not _says_nothing(statement):
            if not isinstance(statement, ast.AnnAssign):
                yield statement
            elif statement.value is not None:  # types alone change nothing when the program runs
                yield statement.value


def changes(tree: ast.Module) -> Iterator[tuple[ast.AST, str, object]]:
    """(node, attribute, new value) of every single change."""
    nodes = [node for top in left_alone(tree.body) for node in ast.walk(top)]
    members: dict[str, list[str]] = {}
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.attr.isupper():
            members.setdefault(node.value.id, []).append(node.attr)
    for node in nodes:
        match node:
            case ast.Dict(keys=keys, values=values):
                for k in range(len(keys)):
                    yield node, "keys values", (keys[:k] + keys[k + 1 :], values[:k] + values[k + 1 :])
            case ast.Set(elts=items) | ast.Tuple(elts=items, ctx=ast.Load()) if len(items) > 1:
                for k in range(len(items)):
                    yield node, "elts", items[:k] + items[k + 1 :]
            case ast.Attribute(value=ast.Name(id=owner), attr=attr) if attr.isupper():
                others = sorted(set(members[owner]) - {attr})
                if others:
                    yield node, "attr", others[(hash_of(attr) + node.lineno) % len(others)]
            case ast.Constant(value=bool(value)):
                yield node, "value", not value
            case ast.Constant(value=int(value) | float(value)):
                yield node, "value", value + 1
            case ast.Constant(value=str(value)) if value:
                yield node, "value", value + "X"
            case ast.Constant(value=bytes(value)) if value:
                yield node, "value", value[:-1] + bytes((value[-1] ^ 1,))
            case ast.Compare(ops=[operator]) if type(operator) in NEIGHBOUR:
                yield node, "ops", [NEIGHBOUR[type(operator)]()]
            case ast.BinOp(op=operator) | ast.BoolOp(op=operator) if type(operator) in NEIGHBOUR:
                yield node, "op", NEIGHBOUR[type(operator)]()


def hash_of(text: str) -> int:
    """The same in every run, unlike ``hash``."""
    return sum(text.encode())


def _says_nothing(statement: ast.stmt) -> bool:
    """A docstring, or a name for the type checker alone."""
    typed = isinstance(statement, ast.Assign) and ast.unparse(statement.value).startswith(("TypeVar(", "NDArray["))
    return typed or _is_docstring(statement)


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def noticed(name: str, path: Path, tree: ast.Module, tests: list[str]) -> bool:
    """Whether the tests fail with this code in place of the module."""
    try:
        code = compile(tree, str(path), "exec")
    except (SyntaxError, ValueError):
        return True
    child = os.fork()
    if child == 0:
        signal.alarm(PATIENCE_S)
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        sys.meta_path.insert(0, Changed(name, path, code))
        os._exit(min(int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests])), 100))
    return os.waitpid(child, 0)[1] != 0


def say(line: str) -> None:
    """One line of the result, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def survivors(target: str) -> int:
    """Try every change of one module; how many survived."""
    path, tests = Path(target), [f"tests/unit/test_{name}.py" for name in TESTS[target]]
    name, tree = ".".join(path.with_suffix("").parts), ast.parse(path.read_text())
    if noticed(name, path, tree, tests):
        sys.exit(f"the tests of {target} fail without any change")
    tried, survived = 0, 0
    for node, attribute, value in changes(tree):
        names, values = attribute.split(), value if " " in attribute else (value,)
        before, line = [getattr(node, n) for n in names], ast.unparse(node)
        for n, v in zip(names, values, strict=True):  # type: ignore[call-overload]
            setattr(node, n, v)
        tried += 1
        if not noticed(name, path, tree, tests):
            survived += 1
            say(f"{target}:{getattr(node, 'lineno', 0)}: {line} -> {ast.unparse(node)}")
        for n, v in zip(names, before, strict=True):
            setattr(node, n, v)
    say(f"{target}: {tried - survived} of {tried} changes noticed")
    return survived


if __name__ == "__main__":
    sys.path.insert(0, os.getcwd())
    sys.exit(1 if sum(survivors(target) for target in sys.argv[1:] or TESTS) else 0)
