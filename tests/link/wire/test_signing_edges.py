"""Signing at its last stamps (a day of them is kept for ourselves), and the file they are kept in."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from link.errors import SigningError
from link.wire import memory_file
from link.wire.signing import MAX_STAMP, Verdict
from link.wire.signing_timestamps import SigningStore
from tests.support.flight_processes import open_files
from tests.support.signing_kit import NOW, Clock, make, refused, sign, stamp_of, taken

DAY_UNITS = 8_640_000_000


def test_a_days_worth_of_stamps_before_the_end_of_their_range_is_kept_for_our_own() -> None:
    codec = make(Clock(NOW))
    assert refused(codec, sign(stamp=MAX_STAMP - DAY_UNITS + 1), Verdict.NO_STAMPS_LEFT)
    assert taken(codec, sign(stamp=MAX_STAMP - DAY_UNITS))
    assert stamp_of(codec.encode(_heartbeat())) == MAX_STAMP - DAY_UNITS + 1


def test_a_stream_stays_known_at_the_stamp_we_hold_ourselves() -> None:
    codec = make(Clock(NOW))
    assert taken(codec, sign(stamp=NOW))
    assert codec.signing is not None
    assert codec.signing.stamp == NOW
    # A new stream is held to our own stamp where that is ahead of the clock.
    assert taken(codec, sign(stamp=NOW + DAY_UNITS, link_id=1))
    assert refused(codec, sign(stamp=NOW + 1, link_id=2), Verdict.TOO_OLD)


def _heartbeat() -> object:
    from tests.support.signing_kit import HEARTBEAT

    return HEARTBEAT


# -- the file ---------------------------------------------------------------------------------------------------------


def in_memory() -> list[Path]:
    """The stamps that lie in shared memory."""
    return list(memory_file.FOLDER.glob("skyrelay-*"))


@pytest.fixture(autouse=True)
def own_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Shared memory of this test's own."""
    folder = tmp_path / "memory"
    folder.mkdir()
    monkeypatch.setattr(memory_file, "FOLDER", folder)
    return folder


def reopened(store: SigningStore, path: Path) -> SigningStore:
    """The store after a restart."""
    store.close()
    return SigningStore.open(path)


def test_a_stamp_is_never_taken_for_a_stream_whatever_its_bits(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "a.stamps"
    store = SigningStore.open(path)
    stamp = 1 << 24 | 3 << 16 | 2 << 8 | 1  # what marks the stream (3, 2, 1)
    store.own_stamp = stamp
    assert store.remember((9, 8, 7), stamp)
    store = reopened(store, path)
    assert (store.own_stamp, store.last_stamp((9, 8, 7)), store.last_stamp((3, 2, 1))) == (stamp, stamp, None)
    store.close()


def test_after_a_restart_each_stream_goes_on_in_its_own_place(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    streams = [(k, 1, 1) for k in range(3)]
    for stream in streams:
        store.remember(stream, 100 + stream[0])
    for restart in range(3):
        store = reopened(store, path)
        assert store.remember((2, 1, 1), 200 + restart)
        store = reopened(store, path)
        assert [store.last_stamp(stream) for stream in streams] == [100, 101, 200 + restart]
    # 255 streams and no more; the rest of the table is still free after all this.
    assert [store.remember((k, 2, 1), 1) for k in range(253)] == [True] * 252 + [False]
    store = reopened(store, path)
    assert [store.last_stamp(stream) for stream in streams] == [100, 101, 202]
    assert store.last_stamp((251, 2, 1)) == 1
    store.close()


def test_a_store_in_use_is_refused_and_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 5
    with pytest.raises(SigningError, match="is in use by another process; stop that one first"):
        SigningStore.open(path)
    store.own_stamp = 6
    store = reopened(store, path)
    assert store.own_stamp == 6
    store.close()


@pytest.mark.parametrize(
    "content",
    [
        b"S" + bytes(4095),
        bytes(4095) + b"1",
        bytes(4097),
        b"SKYSIGN1" + bytes(4080),
        b"SKYSIGN1" + bytes(4096),
        b"SKYSIGN2" + bytes(4088),
    ],
)
def test_a_file_that_is_no_store_is_refused_and_left_as_it_is(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    path.write_bytes(content)
    with pytest.raises(SigningError, match="is damaged or not ours"):
        SigningStore.open(path)
    assert path.read_bytes() == content


def test_a_disk_without_room_for_the_stamps_is_told_before_the_first_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.stamps"

    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", full)
        with pytest.raises(SigningError, match="No space left on device; give a writable place"):
            SigningStore.open(path)
    # Let go of, so that it can be tried again; now it is there in full before a stamp is stored.
    store = SigningStore.open(path)
    assert path.stat().st_size == 4096
    assert path.read_bytes() == b"SKYSIGN1" + bytes(4088)
    store.close()


def test_a_new_store_is_on_the_disk_before_it_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.stamps"
    synced: list[bytes] = []
    monkeypatch.setattr(os, "fsync", lambda _: synced.append(path.read_bytes()))
    store = SigningStore.open(path)
    assert synced == [b"SKYSIGN1" + bytes(4088)]
    store.own_stamp = 7
    store.close()
    assert SigningStore.open(path).own_stamp == 7
    assert [synced[1][8], len(synced)] == [7, 2]


def test_a_closed_store_lets_go_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.remember((1, 1, 1), 7)
    assert in_memory()
    store.close()
    store.close()
    assert not in_memory()
    assert not [one for one in open_files() if one == str(path)]
    # What comes after is known to this process, and to nobody else.
    assert store.remember((1, 1, 1), 8)
    assert store.remember((2, 1, 1), 9)
    store.own_stamp = 10
    assert (store.own_stamp, store.last_stamp((1, 1, 1)), store.last_stamp((2, 1, 1))) == (10, 8, 9)
    again = SigningStore.open(path)
    assert (again.own_stamp, again.last_stamp((1, 1, 1)), again.last_stamp((2, 1, 1))) == (0, 7, None)
    again.close()


def test_stamps_kept_by_an_earlier_version_are_understood(tmp_path: Path) -> None:
    """The layout of the file, word by word: a magic number, our own stamp, then marks and stamps of streams."""
    words = [0x314E474953594B53, 1000, 0x01070201, 2000, 0x01FF0A9A, 3000]
    path = tmp_path / "a.stamps"
    path.write_bytes(b"".join(word.to_bytes(8, sys.byteorder) for word in words).ljust(4096, b"\0"))
    store = SigningStore.open(path)
    assert store.own_stamp == 1000
    assert [store.last_stamp(stream) for stream in ((7, 2, 1), (255, 10, 154))] == [2000, 3000]
    store.close()


def killed(store: SigningStore) -> None:
    """What is left of a store when its process is killed: memory and file as they are, and nothing locked."""
    assert store._file is not None
    os.close(store._file[1])
    store._file = None


def test_a_stamp_stored_is_there_after_a_kill_and_not_before_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 4
    assert store.remember((1, 1, 1), 5)
    before = path.read_bytes()
    assert before == b"SKYSIGN1" + bytes(4088)
    killed(store)
    store = SigningStore.open(path)
    assert (store.own_stamp, store.last_stamp((1, 1, 1))) == (4, 5)
    store.close()
    assert SigningStore.open(path).own_stamp == 4


def test_what_was_saved_outlives_the_memory(tmp_path: Path, own_memory: Path) -> None:
    """A power cut: the file as it was saved last."""
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 4
    assert store.remember((1, 1, 1), 5)
    store.save()
    assert store.remember((1, 1, 1), 6)
    killed(store)
    for left in own_memory.iterdir():
        left.unlink()
    store = SigningStore.open(path)
    assert (store.own_stamp, store.last_stamp((1, 1, 1))) == (4, 5)
    store.close()
    store.save()  # as closed


@pytest.mark.parametrize(("own_in_file", "own"), [(9, 10), (12, 12)])
def test_the_newer_of_memory_and_file_counts_stream_by_stream(own_in_file: int, own: int, tmp_path: Path) -> None:
    """A file restored or used without shared memory since, beside what a killed process left."""
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    for stream, stamp in (((1, 1, 1), 11), ((2, 1, 1), 22)):
        assert store.remember(stream, stamp)
    killed(store)
    words = [0x314E474953594B53, own_in_file, 0x01020101, 33, 0x01030101, 44, 0x01010101, 10, 0x01040101, 0]
    path.write_bytes(b"".join(word.to_bytes(8, sys.byteorder) for word in words).ljust(4096, b"\0"))
    store = SigningStore.open(path)
    assert store.own_stamp == own
    assert [store.last_stamp((k, 1, 1)) for k in (1, 2, 3, 4)] == [11, 33, 44, 0]
    store = reopened(store, path)
    assert [store.last_stamp((k, 1, 1)) for k in (1, 2, 3, 4)] == [11, 33, 44, 0]
    store.close()


def test_the_memory_is_private_and_whoever_clears_it_away_does_no_harm(tmp_path: Path, own_memory: Path) -> None:
    store = SigningStore.open(tmp_path / "a.stamps")
    (memory,) = own_memory.iterdir()
    assert memory.stat().st_mode & 0o777 == 0o600
    assert len([one for one in open_files() if one == str(memory)]) == 1
    store.own_stamp = 10
    memory.unlink()
    store.close()
    assert SigningStore.open(tmp_path / "a.stamps").own_stamp == 10


def test_a_new_file_knows_nothing_of_an_old_ones_memory(tmp_path: Path, own_memory: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    killed(store)
    path.write_bytes(b"")  # the same file to the system, emptied
    assert len(in_memory()) == 1
    store = SigningStore.open(path)
    assert store.own_stamp == 0
    store.close()


def foreign(left: Path) -> None:
    os.chown(left, 12345, 12345)


def a_link(left: Path) -> None:
    left.unlink()
    left.symlink_to("/etc/passwd")


def of_another_size(left: Path) -> None:
    left.write_bytes(b"x" * 100)


def a_folder(left: Path) -> None:
    left.unlink()
    left.mkdir()


@pytest.mark.parametrize("spoil", [foreign, a_link, of_another_size, a_folder])
def test_memory_that_is_not_ours_is_left_alone_and_the_file_itself_used(
    spoil: Callable[[Path], None], tmp_path: Path, own_memory: Path
) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    killed(store)
    (left,) = own_memory.iterdir()
    try:
        spoil(left)
    except PermissionError:
        pytest.skip("only root gives files away")
    before = left.lstat()
    store = SigningStore.open(path)
    assert store.own_stamp == 0
    store.own_stamp = 20
    assert path.read_bytes()[8] == 20  # at once: the file itself is mapped
    store.save()
    store.close()
    assert (left.lstat().st_ino, left.lstat().st_size) == (before.st_ino, before.st_size)
    assert SigningStore.open(path).own_stamp == 20


def test_without_shared_memory_the_file_itself_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory_file, "FOLDER", tmp_path / "none")
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    assert path.read_bytes()[8] == 10
    store = reopened(store, path)
    assert store.own_stamp == 10
    store.close()


def test_stamps_that_cannot_be_written_out_stay_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10

    def broken(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", broken)
        with pytest.raises(OSError, match="Input/output"):
            store.close()
    assert not [one for one in open_files() if one == str(path)]
    store = SigningStore.open(path)
    assert store.own_stamp == 10
    store.close()
