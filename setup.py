"""The one step of the build that pyproject.toml cannot say: the MAVLink dialect is generated, not committed.

A wheel gets it in the build folder, an editable install in the source tree, where it is imported from; an sdist carries
what it is made from. All three through ``link/dialect/regenerate.py``.
"""

import runpy
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

DIALECT = Path("link") / "dialect"


class BuildWithDialect(build_py):
    """Python modules as ever, and the dialect module made anew beside them."""

    def run(self) -> None:
        """Build, then generate."""
        super().run()
        folder = DIALECT if self.editable_mode else Path(self.build_lib) / DIALECT
        runpy.run_path(str(DIALECT / "regenerate.py"))["generate"](folder / "skyrelay.py")


setup(cmdclass={"build_py": BuildWithDialect})
