"""The folder of link locks is this user's own, or nothing flies."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

import pytest

from link.errors import EndpointError
from link.transport import LinkLocks
from link.transport.port_lock import lock_folder

URL = "udpout:127.0.0.1:14550"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return lock_folder()


def test_a_folder_somebody_else_made_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    if os.getuid() == 0:
        os.chown(folder, 65534, 65534)
    else:
        owner = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: owner + 1)
        folder.rename(lock_folder())
    with pytest.raises(EndpointError, match="not a folder of this user's own"):
        LinkLocks([URL])


def test_a_link_or_a_file_in_its_place_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(EndpointError):
        LinkLocks([URL])
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_folder_open_to_others_is_closed(folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)
    locks = LinkLocks([URL])
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    locks.release()
