"""One flight a link: a lock on every link URL for as long as a streamer lives.

Two streamers on one link would both be obeyed (PX4 does not look at the sender), and no gate spans two processes. The
kernel lets go of the locks when their process dies, however it dies.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import stat
import tempfile
from collections.abc import Iterable
from pathlib import Path

from link.errors import EndpointError


def lock_folder() -> Path:
    """Where the locks of this user are."""
    return Path(tempfile.gettempdir()) / f"skyrelay-links-{os.getuid()}"


class LinkLocks:
    """Locks on link URLs. Raises `EndpointError` when another flight holds one."""

    def __init__(self, urls: Iterable[str]) -> None:
        folder = lock_folder()
        _make_own(folder)
        self._descriptors: list[int] = []
        for url in dict.fromkeys(urls):
            path = folder / hashlib.sha256(url.encode()).hexdigest()[:32]
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(descriptor)
                self.release()
                raise EndpointError(f"{url}: another flight on this machine uses this link; end it first") from None
            self._descriptors.append(descriptor)

    def release(self) -> None:
        """Let go."""
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors.clear()


def _make_own(folder: Path) -> None:
    """Make the folder; one that is there must be this user's. Raises `EndpointError`.

    Its place can be written to by everybody: whoever made it first could take locks away or lead them elsewhere.
    """
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise EndpointError(
            f"{folder}: links are locked here, and it is not a folder of this user's own; remove it, or set TMPDIR to "
            "a folder of your own, the same for every program that flies"
        )
    if found.st_mode & 0o077:
        folder.chmod(0o700)
