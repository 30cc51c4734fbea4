"""Makes ``skyrelay.py`` from ``skyrelay.xml``: ``python link/dialect/regenerate.py``; ``make setup`` and builds do it.

pymavlink's wheel carries the XML of its dialects beside the modules, so the overlay here is a page long and includes
them. mavgen resolves an include beside the file that includes it: both are brought together in a temporary folder.

This file is run and loaded by its path, never as ``link.dialect.regenerate``, where the module is not there yet (that
package cannot be imported without it), so it imports nothing of ours.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
import tempfile
from pathlib import Path

import pymavlink
from pymavlink.generator import mavgen, mavparse

HERE = Path(__file__).resolve().parent
OVERLAY = HERE / "skyrelay.xml"
MODULE = HERE / "skyrelay.py"
_INCLUDED = ("common.xml", "standard.xml", "minimal.xml")


def generate(output: Path) -> None:
    """Write the dialect module for wire protocol 2.0 to ``output``, whole or not at all (its stem names the dialect).

    Raises `RuntimeError` with mavgen's own words when it refuses the XML.
    """
    definitions = Path(pymavlink.__file__).parent / "dialects" / "v20"
    words = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory(dir=output.parent) as beside:
        for source in (OVERLAY, *(definitions / name for name in _INCLUDED)):
            shutil.copy(source, folder)
        made = Path(beside) / output.name
        options = mavgen.Opts(str(made), wire_protocol=mavparse.PROTOCOL_2_0, language="Python3", validate=True)
        with contextlib.redirect_stdout(words):
            done = mavgen.mavgen(options, [str(Path(folder) / OVERLAY.name)])
        if not done:
            raise RuntimeError(f"mavgen refused {OVERLAY.name}: {words.getvalue()}")
        os.replace(made, output)


def main() -> int:
    """Make the module where it is imported from."""
    generate(MODULE)
    sys.stdout.write(f"wrote {MODULE.name}, {MODULE.stat().st_size} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
