"""Debian's chromium for the tests of the page, driven by Playwright, drawing WebGL in software.

``python -m tests.support.processes.browser`` installs it where that is possible (Debian, as root) and needed; anywhere
else it says in one line what will be skipped.
"""

from __future__ import annotations

import os
import shutil
import subprocess

MISSING = "chromium is not on this machine: the page is not tested in a browser (Debian: apt-get install chromium)"
# No background traffic of the browser's own; the last ones draw WebGL without a graphics processor.
ARGUMENTS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)


def program() -> str | None:
    """The browser's path; None where there is none."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


def main() -> None:
    """Install the package where it is missing and may be installed."""
    apt = shutil.which("apt-get")
    if program() is None and apt is not None and os.getuid() == 0:
        print("installing chromium for the tests (apt-get install chromium)", flush=True)
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for command in (["update"], ["install", "-y", "--no-install-recommends", "chromium", "fonts-liberation"]):
            subprocess.run([apt, "-qq", *command], env=environment, check=False, stdout=subprocess.DEVNULL)
    if program() is None:
        print(MISSING, flush=True)


if __name__ == "__main__":
    main()
