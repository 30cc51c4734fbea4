"""What no tracked text may hold: an address in a file that says what is installed, a path of one machine.

Both are found by kind, not by a list of names: a file of packages holds no address at all, and a path is one of a
machine when it leads into somebody's home or to where this checkout happens to lie.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import fnmatch
from pathlib import Path

PACKAGE_FILES = (
    "requirements*",
    "*.lock",
    "pyproject.toml",
    "setup.cfg",
    "setup.py",
    "package.json",
    "package-lock.json",
    ".npmrc",
    "pip.conf",
    "uv.toml",
    "Makefile",
    "Dockerfile*",
    "*.dockerfile",
    ".ci/*",
    ".github/*",
    ".gitlab-ci.yml",
)
"""Files that say what is installed and from where, or run what does: by name, or by folder and name."""

ADDRESS = re.compile(r"\b[a-z][a-z0-9+.-]*://|--?(?:extra-)?index-url|--find-links|--trusted-host|\bregistry\s*=", re.I)
"""A URL of any scheme, or the option of an installer that takes one."""

HOMES = re.compile(r"(?<![\w.])/(?:home|Users)/[\w.-]+/|(?<![\w.])/(?:root)/|\b[A-Z]:\\Users\\", re.ASCII)
"""A path into a person's home, whoever's."""

STANDARD_FOLDERS = frozenset(
    (
        *("bin", "boot", "dev", "etc", "home", "lib", "lib64", "media", "mnt", "opt", "private", "proc", "root", "run"),
        *("sbin", "srv", "sys", "tmp", "usr", "var", "Users"),
    )
)
"""What lies at the top of most machines; a folder beside them is one machine's own."""


def own_paths(checkout: Path, home: Path) -> list[str]:
    """Beginnings of paths that only this machine has: the checkout, what it lies in, this user's home."""
    found = []
    for path in (checkout, *checkout.parents, home):
        depth = len(path.parts) - 1  # the root itself is a part
        if depth >= 2 or (depth == 1 and path.name not in STANDARD_FOLDERS):
            found.append(path.as_posix())
    return sorted(set(found))


def addresses(root: Path, files: Iterable[Path]) -> list[str]:
    """Addresses in package files below `root`."""
    chosen = [path for path in files if any(_named(path.relative_to(root), kind) for kind in PACKAGE_FILES)]
    return _lines(root, chosen, ADDRESS)


def machine_paths(root: Path, files: Iterable[Path], own: Iterable[str] = ()) -> list[str]:
    """Paths of one machine in any of the files: homes, and what lies below one of `own`."""
    mine = "|".join(rf"(?<![\w.]){re.escape(path)}/" for path in own)
    return _lines(root, files, re.compile(f"{HOMES.pattern}|{mine}" if mine else HOMES.pattern, re.ASCII))


def _named(path: Path, kind: str) -> bool:
    return fnmatch(path.as_posix() if "/" in kind else path.name, kind)


def _lines(root: Path, files: Iterable[Path], pattern: re.Pattern[str]) -> list[str]:
    """Every line of a text file that the pattern is found in; files that are no text are passed over."""
    found = []
    for path in files:
        content = path.read_bytes()
        if b"\0" in content[:8192]:
            continue
        for number, line in enumerate(content.decode("utf-8", errors="replace").splitlines(), 1):
            match = pattern.search(line)
            if match is not None:
                found.append(f"{path.relative_to(root).as_posix()}:{number}: {match.group()}")
    return found
