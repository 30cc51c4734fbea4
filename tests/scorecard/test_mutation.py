"""Scorecard 30: of the small changes to what an aircraft hangs on, the tests notice all but one in twenty."""

from __future__ import annotations

import ast
import json
import subprocess
import sys

import pytest

from tests.scorecard import mutation
from tests.support.paths import ROOT

SOURCE = '''
LIMIT = 2.5

def f(a, b, done=False):
    """Text stays."""
    total = a + b
    if a < b and not done:
        return f"{a + 1} of {b}"
    self.last = total
    return total
'''


def test_every_small_change_is_made_once_and_undone() -> None:
    before = ast.unparse(ast.parse(SOURCE))
    found = [m.name for m in mutation.mutants(SOURCE, "f.py")]
    assert sorted(found) == sorted(
        [
            ": 2.5 -> 3.5",
            ": 2.5 -> 1.5",
            "f: False -> True",
            "f: a + b -> a - b",
            "f: if a < b and (not done) -> if not (a < b and (not done))",
            "f: a < b and (not done) -> a < b or not done",
            "f: a < b -> a <= b",
            "f: a < b -> a >= b",
            "f: not done -> done",
            "f: return f'{a + 1} of {b}' -> return None",
            "f: self.last = total -> nothing",
            "f: return total -> return None",
        ]
    )
    assert ast.unparse(ast.parse(SOURCE)) == before
    codes = {m.code.co_consts for m in mutation.mutants("x = 1\n", "x.py")}
    assert len(codes) == 2  # 2 and 0


@pytest.mark.slow
def test_what_is_called_equivalent_exists_and_has_a_reason() -> None:
    listed = json.loads(mutation.EQUIVALENT.read_text(encoding="utf-8"))
    assert set(listed) <= set(mutation.MODULES)
    for module, reasons in listed.items():
        names = {m.name for m in mutation.mutants((ROOT / module).read_text(encoding="utf-8"), module)}
        for name, reason in reasons.items():
            assert name in names, f"{module}: there is no mutant {name}"
            assert len(reason) > 10


@pytest.mark.soak
@pytest.mark.timeout(0)
@pytest.mark.parametrize("module", sorted(mutation.MODULES))
def test_the_tests_notice_nineteen_of_twenty_changes(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.scorecard.mutation", module],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
