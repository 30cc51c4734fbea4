"""Writes docs/third-party-notices.md from the lock files and the installed packages' own metadata.

Run ``python -m tests.support.third_party`` after the lock file changes; a test holds the page against the lock.
"""

from __future__ import annotations

import json
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


PAGE_HEADER = """
## The page

The page is served with files of these npm packages, versions and hashes as in `package-lock.json`, or with what their
makers built into those files. The land is Natural Earth's (public domain), by way of `world-atlas`.

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


def page_parts() -> dict[str, tuple[str, str]]:
    """Versions and licences of the npm packages whose files the page is served with (`setup_web.py`)."""
    packages = json.loads((ROOT / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    own = {path.removeprefix("node_modules/"): entry for path, entry in packages.items() if path}
    # TypeScript declarations are never served.
    served = {n: e for n, e in own.items() if not e.get("dev") and not n.startswith("@types/")}
    return {name: (entry["version"], entry.get("license", "see the package")) for name, entry in served.items()}


def main() -> None:
    rows = [f"| {name} | {version} | {licence_of(name)} |" for name, version in sorted(locked().items())]
    parts = [f"| {name} | {version} | {licence} |" for name, (version, licence) in sorted(page_parts().items())]
    PAGE.write_text("\n".join([HEADER + "\n".join(rows), PAGE_HEADER + "\n".join(parts)]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
