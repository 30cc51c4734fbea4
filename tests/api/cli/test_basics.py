"""What every command does alike: help, complaints, files, pipes, signals, children."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from api.cli import files
from api.cli.console import Progress
from api.cli.errors import BadInputError, CommandError
from api.processes.children import ChildError, Children
from tests.support.processes.cli_process import SKYRELAY
from tests.support.processes.tree import alive

Cli = Callable[..., "object"]


def test_help_names_every_command_and_needs_nothing_heavy(cli: Cli) -> None:
    outcome = cli("--help")
    assert outcome.code == 0
    for command in ("plan", "setpoints", "simulate", "serve", "doctor"):
        assert command in outcome.out
    code = "import sys, api.cli; print([m for m in ('numpy', 'fastapi', 'clarabel', 'sqlalchemy') if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plam"], "plan"),
        (["plan"], "MISSION.json"),
        (["plan", "--fasst", "m.json"], "--fast"),
        (["setpoints", "p.json", "--rate", "quick"], "--rate"),
        (["setpoints", "p.json", "--format", "xls"], "'csv', 'jsonl', 'tlog'"),
        (["plan", "no-such-file.json"], "no-such-file.json"),
        (["plan", "."], "directory"),
    ],
)
def test_bad_arguments_are_bad_input_said_in_one_block_on_stderr(cli: Cli, arguments: list[str], said: str) -> None:
    outcome = cli(*arguments)
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.startswith("error: ")
    assert said in outcome.err
    assert "Traceback" not in outcome.err
    assert "\n\n\n" not in outcome.err


def test_version_is_printed(cli: Cli) -> None:
    outcome = cli("--version")
    assert outcome.code == 0
    assert outcome.out.startswith("skyrelay 0.")


def test_a_fault_of_ours_is_exit_1_without_a_traceback(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("wires crossed")

    monkeypatch.setattr(files, "read_bytes", broken)
    outcome = cli("plan", "m.json")
    assert outcome.code == 1
    assert outcome.out == ""
    assert "wires crossed" in outcome.err
    assert "Traceback" not in outcome.err


def test_block_lines_up_and_keeps_faults_apart() -> None:
    error = BadInputError("two things", {"where": "a", "value": 3, "fix": None}, {"where": "b", "what": "x\ny"})
    assert error.block() == (
        "error: two things\n  where:    a\n  value:    3\n\n  where:    b\n  what:     x\n            y"
    )
    assert CommandError.exit_code == 1


def test_what_could_act_on_a_terminal_is_shown_escaped() -> None:
    block = BadInputError("x", {"value": "a\x1b[2Jb"}, {"value": "half \ud800"}, {"value": "Grüße"}).block()
    assert "\x1b" not in block
    assert "a\\u001b[2Jb" in block
    assert "\\ud800" in block
    assert "Grüße" in block


# -- files ------------------------------------------------------------------------------------------------------------


def test_a_file_appears_whole_and_replaces_what_was_there(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    target.write_bytes(b"old")
    target.chmod(0o640)
    files.write_chunks([b"new ", b"content"], str(target))
    assert target.read_bytes() == b"new content"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert os.listdir(tmp_path) == ["out.csv"]


def test_an_error_half_way_leaves_the_old_file_and_no_rubbish(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    target.write_bytes(b"old")

    def chunks() -> Iterator[bytes]:
        yield b"half"
        raise BadInputError("no more")

    with pytest.raises(BadInputError):
        files.write_chunks(chunks(), str(target))
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["out.csv"]


def test_a_link_is_followed_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "real.json").write_text("old")
    (tmp_path / "link.json").symlink_to("real.json")
    files.write_text("new", str(tmp_path / "link.json"))
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "real.json").read_text() == "new"


def test_pipes_and_devices_are_written_straight(tmp_path: Path) -> None:
    files.write_text("gone", os.devnull)
    fifo = tmp_path / "pipe"
    os.mkfifo(fifo)
    heard: list[bytes] = []
    reader = threading.Thread(target=lambda: heard.append(fifo.read_bytes()))
    reader.start()
    files.write_text("through", str(fifo))
    reader.join(5)
    assert heard == [b"through"]


@pytest.mark.parametrize("place", ["missing/out.json", "."])
def test_a_place_that_cannot_be_written_is_bad_input(tmp_path: Path, place: str) -> None:
    with pytest.raises(BadInputError) as error:
        files.write_text("x", str(tmp_path / place))
    assert str(tmp_path / place) in error.value.block()


@pytest.mark.slow
def test_a_full_disk_is_told_and_leaves_nothing() -> None:
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [*SKYRELAY, "doctor", "--json"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


def test_input_over_the_limit_is_not_read_to_the_end(tmp_path: Path) -> None:
    (tmp_path / "big").write_bytes(b"x" * 101)
    with pytest.raises(BadInputError, match="too large"):
        files.read_bytes(str(tmp_path / "big"), what="mission", limit_bytes=100)


# -- progress ---------------------------------------------------------------------------------------------------------


def test_off_a_terminal_progress_is_a_plain_line_every_few_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    with Progress(every_s=5.0, clock=lambda: now[0]) as progress:
        for second in range(13):
            now[0] = float(second)
            progress.show(f"T+ {second}")
    assert capsys.readouterr().err.splitlines() == ["T+ 0", "T+ 5", "T+ 10", "T+ 12"]


# -- children ---------------------------------------------------------------------------------------------------------


def test_children_and_their_children_end_with_the_context() -> None:
    nested = "import subprocess, time; p = subprocess.Popen(['sleep', '99']); print(p.pid, flush=True); time.sleep(99)"
    with Children() as children:
        child = children.start("parent", [sys.executable, "-c", nested])
        while not child.output():
            time.sleep(0.02)
        grandchild = int(child.output())
        assert alive(grandchild)
    time.sleep(0.2)
    assert child.process.poll() is not None
    assert not alive(grandchild)


def test_a_child_that_will_not_end_is_made_to() -> None:
    stubborn = (
        "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True); time.sleep(100)"
    )
    children = Children()
    child = children.start("mule", [sys.executable, "-c", stubborn])
    while not child.output():
        time.sleep(0.02)
    child.stop(timeout_s=0.3)
    assert child.process.returncode == -signal.SIGKILL


def test_a_child_that_ends_by_itself_is_quoted() -> None:
    with Children() as children:
        child = children.start("helper", [sys.executable, "-c", "raise SystemExit('no such port')"])
        child.process.wait(20)
        with pytest.raises(ChildError) as error:
            children.check()
    assert "helper" in error.value.what
    assert "no such port" in str(error.value.details["said"])


@pytest.mark.skipif(sys.platform != "linux", reason="prctl is Linux's")
def test_children_end_when_the_command_is_killed_outright() -> None:
    program = (
        "import sys, time; from api.processes.children import ChildError, Children\n"
        "c = Children().start('x', ['sleep', '100']); print(c.process.pid, flush=True); time.sleep(100)"
    )
    command = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert command.stdout is not None
    pid = int(command.stdout.readline())
    assert alive(pid)
    command.kill()
    command.wait()
    for _ in range(100):
        if not alive(pid):
            break
        time.sleep(0.05)
    assert not alive(pid)
    command.stdout.close()
