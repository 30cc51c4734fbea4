"""Mutation testing of the modules an aircraft hangs on.

``python -m tests.scorecard.mutation link/transport/gate.py ...`` from the root.

Each mutant is the module with one small change: a comparison turned or moved by one step, ``and`` for ``or``, an
operator or a constant changed, a condition negated, a result dropped, a statement left out. Its tests (`MODULES`) must
fail. Those that do not are *survivors*: a test is missing, or the change makes no difference. The latter are listed,
each with its reason, in ``mutants_equivalent.json``, and counted apart.

A mutant is tried in a fork of a process that has imported everything which does not depend on it, so that a second's
work is not spent on imports. Statements whose loss is a NameError (plain local assignments), texts, annotations and
the file's head are left alone: they would only flatter the score.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib.abc
import importlib.machinery
import json
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType

from tests.support.paths import ROOT

EQUIVALENT = Path(__file__).with_name("mutants_equivalent.json")
MODULES: dict[str, tuple[str, ...]] = {
    "link/transport/gate.py": ("tests/link/transport/test_gate.py",),
    "link/handover/handover.py": ("tests/link/handover/test_handover.py",),
    "link/wire/signing.py": ("tests/link/wire/test_signing.py",),
    "link/wire/signing_timestamps.py": ("tests/link/wire/test_signing.py",),
    "link/wire/memory_file.py": ("tests/link/wire/test_signing.py",),
    "link/clock.py": ("tests/link/test_clock.py",),
    "link/streamer/process.py": ("tests/link/streamer/test_loop.py",),
    "link/streamer/recorder.py": ("tests/link/streamer/test_loop.py",),
    "link/streamer/scheduling.py": ("tests/link/streamer/test_loop.py",),
    "gcs/operator_commands.py": ("tests/scorecard/test_commands.py", "tests/gcs/test_operator_commands.py"),
}
"""What is mutated, and the fast tests that must notice."""
NOT_RUN = ("runTest", "killed_at_any_instant", "two_processes")
"""Names of tests that take seconds and see no change: the stateful ones, and those whose subject is a process of its
own, which imports the module as it is."""
CPU_LIMIT_S, WALL_LIMIT_S = 20, 120.0

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Mod: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
DROPPED = (ast.Expr, ast.AugAssign, ast.Raise, ast.Delete, ast.Continue, ast.Break)


@dataclass(frozen=True)
class Mutant:
    """One change: its name (where, from, to; stable when lines move), its line and the changed module's code."""

    name: str
    line: int
    code: CodeType


def mutants(source: str, filename: str) -> Iterator[Mutant]:
    """Every mutant of a module, one at a time."""
    tree = ast.parse(source, filename)
    seen: dict[str, int] = {}
    for where, node, before, after, undo in _changes(tree, ""):
        shown = f"{where}: {before} -> {after}"
        seen[shown] = seen.get(shown, 0) + 1
        name = shown if seen[shown] == 1 else f"{shown} #{seen[shown]}"
        code = compile(ast.fix_missing_locations(tree), filename, "exec")
        yield Mutant(name, getattr(node, "lineno", 0), code)
        undo()


Change = tuple[str, ast.AST, str, str, "Undo"]


class Undo:
    """Puts back what a change replaced."""

    def __init__(self, holder: object, name: str, index: int | None, value: object) -> None:
        self._holder, self._name, self._index = holder, name, index
        self._old = getattr(holder, name) if index is None else getattr(holder, name)[index]
        self._set(value)

    def __call__(self) -> None:
        self._set(self._old)

    def _set(self, value: object) -> None:
        if self._index is None:
            setattr(self._holder, self._name, value)
        else:
            getattr(self._holder, self._name)[self._index] = value


def _text(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 90 else text[:87] + "..."


def _changes(node: ast.AST, where: str) -> Iterator[Change]:
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_comment") or isinstance(node, ast.JoinedStr):
            continue
        children = value if isinstance(value, list) else [value]
        for index, child in enumerate(children):
            if not isinstance(child, ast.AST) or _left_alone(child):
                continue
            inside = where
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                inside = f"{where}.{child.name}".lstrip(".")
            place = index if isinstance(value, list) else None
            for before, after, undo in _here(child, node, name, place):
                yield inside, child, before, after, undo
            yield from _changes(child, inside)


def _left_alone(node: ast.AST) -> bool:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True  # a docstring
    if isinstance(node, ast.If) and _text(node.test) == "TYPE_CHECKING":
        return True
    return isinstance(node, ast.Import | ast.ImportFrom)


def _here(node: ast.AST, parent: ast.AST, name: str, index: int | None) -> Iterator[tuple[str, str, Undo]]:
    before = _text(node)
    if isinstance(node, ast.Compare):
        for k, operator in enumerate(node.ops):
            for other in COMPARISONS[type(operator)]:
                undo = Undo(node, "ops", k, other())
                yield before, _text(node), undo
    elif isinstance(node, ast.BoolOp):
        undo = Undo(node, "op", None, ast.Or() if isinstance(node.op, ast.And) else ast.And())
        yield before, _text(node), undo
    elif isinstance(node, ast.BinOp | ast.AugAssign) and not _is_text(node):
        undo = Undo(node, "op", None, OPERATORS[type(node.op)]())
        yield before, _text(node), undo
    elif isinstance(node, ast.UnaryOp):
        undo = Undo(parent, name, index, node.operand)
        yield before, _text(node.operand), undo
    elif isinstance(node, ast.Constant):
        for value in _other_values(node.value):
            undo = Undo(parent, name, index, ast.Constant(value))
            yield before, repr(value), undo
    elif isinstance(node, ast.Return) and node.value is not None and _text(node.value) != "None":
        undo = Undo(node, "value", None, ast.Constant(None))
        yield before, "return None", undo
    if isinstance(node, ast.If | ast.While | ast.IfExp):
        undo = Undo(node, "test", None, ast.UnaryOp(ast.Not(), node.test))
        yield f"if {_text(node.test.operand)}", f"if {_text(node.test)}", undo  # type: ignore[attr-defined]
    if index is not None and (isinstance(node, DROPPED) or _sets_an_attribute(node)):
        undo = Undo(parent, name, index, ast.Pass())
        yield before, "nothing", undo


def _is_text(node: ast.BinOp | ast.AugAssign) -> bool:
    sides = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.value,)
    return any(
        isinstance(side, ast.JoinedStr) or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in sides
    )


def _sets_an_attribute(node: ast.AST) -> bool:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    flat = [t for target in targets for t in (target.elts if isinstance(target, ast.Tuple) else [target])]
    return bool(flat) and all(isinstance(target, ast.Attribute | ast.Subscript) for target in flat)


def _other_values(value: object) -> tuple[object, ...]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int):
        return value + 1, value - 1
    if isinstance(value, float):
        return value + 1.0, value - 1.0
    return ()


class Injector(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from code made here."""

    def __init__(self, module: str, path: Path, code: CodeType) -> None:
        self._module, self._path, self._code = module, path, code

    def find_spec(self, name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        if name != self._module:
            return None
        return importlib.machinery.ModuleSpec(name, self, origin=str(self._path))

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        return None

    def get_code(self, name: str) -> CodeType:
        """For `runpy`, which runs a module as a program."""
        return self._code

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._path)
        exec(self._code, module.__dict__)


def warm_up() -> None:
    """Import what no mutant is part of, once for all forks."""
    import hypothesis.stateful
    import numpy
    import pytest
    import scipy.optimize

    import link.dialect
    import sitl_fixtures.vehicle
    from tests.support.plans import planned

    planned.relay_plan(3)
    planned.relay_plan(2)
    assert all((hypothesis.stateful, numpy, pytest, scipy.optimize, link.dialect, sitl_fixtures.vehicle))


def outcome(module: str, path: Path, code: CodeType, tests: tuple[str, ...]) -> str:
    """Run the tests on a changed module in a fork: ``survived``, ``killed``, ``timeout``, or a fault of ours."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S))
        quiet = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2) if "MUTATION_SHOW" not in os.environ else ():
            os.dup2(quiet, descriptor)
        result = 99
        try:
            sys.meta_path.insert(0, Injector(module, path, code))
            import pytest

            options = ["-x", "-q", "--no-header", "-p", "no:cacheprovider"]
            options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
            result = int(
                pytest.main([*options, "-m", "not slow and not soak", "-k", f"not ({' or '.join(NOT_RUN)})", *tests])
            )
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(result)
    status = _wait(child)
    if status is None or os.WIFSIGNALED(status):
        return "timeout"
    # 1: a test failed; 2 and 3: it could not even be collected.
    return {0: "survived", 1: "killed", 2: "killed", 3: "killed", 99: "killed"}.get(os.WEXITSTATUS(status), "fault")


def _wait(child: int) -> int | None:
    descriptor = os.pidfd_open(child)
    try:
        ready, _, _ = select.select([descriptor], [], [], WALL_LIMIT_S)
    finally:
        os.close(descriptor)
    # What the tests started dies with them; the fork leads a process group of its own.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return status if ready else None


def examine(name: str, *, every: int = 1, only: str = "", from_line: int = 0) -> tuple[int, int, int]:
    """Try a module's mutants; (tried, noticed, equivalent). Prints survivors as they are found."""
    path = ROOT / name
    module = name.removesuffix(".py").replace("/", ".")
    tests = tuple(test for test in MODULES[name] if (ROOT / test).exists())
    source = path.read_text(encoding="utf-8")
    equivalent = json.loads(EQUIVALENT.read_text(encoding="utf-8")).get(name, {}) if EQUIVALENT.exists() else {}
    started = time.monotonic()
    if outcome(module, path, compile(source, str(path), "exec"), tests) != "survived":
        raise SystemExit(f"{name}: its tests fail as it is")
    print(f"{name}: {', '.join(tests)} ({time.monotonic() - started:.1f} s a run)", flush=True)
    tried = noticed = same = 0
    unused = set(equivalent)
    for number, mutant in enumerate(mutants(source, str(path))):
        if number % every or only not in mutant.name or mutant.line < from_line:
            continue
        unused.discard(mutant.name)
        if mutant.name in equivalent:
            same += 1
            continue
        tried += 1
        if not tried % 25:
            print(f"  ... {tried}, line {mutant.line}", file=sys.stderr, flush=True)
        result = outcome(module, path, mutant.code, tests)
        if result == "fault":
            raise SystemExit(f"{name}: pytest could not run for {mutant.name}")
        noticed += result != "survived"
        if result == "survived":
            print(f"  {name}:{mutant.line} {mutant.name}", flush=True)
    for stale in sorted(unused) if every == 1 and not only and not from_line else ():
        print(f"  listed as equivalent, but there is no such mutant: {stale}")
    minutes = (time.monotonic() - started) / 60.0
    score = 100.0 * noticed / tried if tried else 100.0
    print(f"{name}: {noticed} of {tried} noticed, {score:.1f} %; {same} equivalent; {minutes:.1f} min", flush=True)
    return tried, noticed, same


def main() -> int:
    """Examine the modules named, all by default; 1 where a score is below the limit."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("modules", nargs="*", choices=[*MODULES, []], default=[], metavar="MODULE")
    parser.add_argument("--every", type=int, default=1, help="try one in so many")
    parser.add_argument("--only", default="", help="mutants whose name holds this")
    parser.add_argument("--from-line", type=int, default=0, metavar="N", help="mutants of this line on")
    parser.add_argument("--least", type=float, default=95.0, help="score in percent below which the exit code is 1")
    options = parser.parse_args()
    warm_up()
    chosen = {"every": options.every, "only": options.only, "from_line": options.from_line}
    scores = [examine(name, **chosen) for name in options.modules or MODULES]
    tried, noticed = sum(s[0] for s in scores), sum(s[1] for s in scores)
    print(f"together: {noticed} of {tried} noticed, {100.0 * noticed / max(1, tried):.1f} %")
    return int(any(n < t * options.least / 100.0 for t, n, _ in scores))


if __name__ == "__main__":
    os.chdir(ROOT)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Loading every plugin there is takes five times as long as the tests do.
    os.environ |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": "_hypothesis_pytestplugin,pytest_timeout"}
    sys.exit(main())
