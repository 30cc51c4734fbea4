"""Writes docs/third-party-notices.md from the lock file and the installed packages' own metadata.

Run ``python -m tests.support.third_party`` after the lock file changes; a test holds the page against the lock.
"""

from __future__ import annotations

import re
from importlib import metadata

from tests.support.paths import ROOT

PAGE = ROOT / "docs" / "third-party-notices.md"

HEADER = """# Third-party notices

skyrelay itself is under the Apache License 2.0 (see `LICENSE`). It installs the packages below, each under its own
licence; versions and hashes are those of `requirements.lock`. The MAVLink dialect in `link/dialect/` is generated from
the message definitions of the MAVLink project (MIT licence) as shipped with pymavlink, plus the few definitions of
`link/dialect/skyrelay.xml`. The recordings in `sitl_fixtures/recordings/` are this project's own.

| package | version | licence |
|---|---|---|
"""


def locked() -> dict[str, str]:
    """Names and versions of the lock file."""
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    return dict(re.findall(r"^([A-Za-z0-9._-]+)==([^ ;\\\n]+)", text, flags=re.MULTILINE))


def licence_of(name: str) -> str:
    """The licence a package states of itself: expression, classifiers, or the first line of the field."""
    try:
        data = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return "only on other platforms"
    expression = data.get("License-Expression")
    classifiers = [c.split(" :: ")[-1] for c in data.get_all("Classifier") or [] if c.startswith("License :: ")]
    field = (data.get("License") or "").strip().splitlines()
    stated = expression or "; ".join(c for c in classifiers if c != "OSI Approved") or (field[0] if field else "")
    return stated[:80] or "see the package"


def main() -> None:
    rows = [f"| {name} | {version} | {licence_of(name)} |" for name, version in sorted(locked().items())]
    PAGE.write_text(HEADER + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
