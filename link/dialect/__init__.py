"""The pinned MAVLink dialect: pymavlink's common.xml plus operator control, generated into one module.

``mavlink`` is the generated module: message classes ``MAVLink_<name>_message``, ids, enums and the ``MAVLink`` packer
and parser, wire protocol 2.0. It is typed as ``Any``: generated code is not ours to annotate. It is not committed:
``link/dialect/regenerate.py`` makes it from ``skyrelay.xml``, at ``make setup`` and in every build.
"""

from importlib import import_module
from typing import Any


def _generated() -> Any:
    name = "link.dialect.skyrelay"
    try:
        return import_module(name)
    except ModuleNotFoundError as missing:
        if missing.name != name:
            raise
        raise ImportError(
            "the MAVLink dialect link/dialect/skyrelay.py is generated and has not been made here: run `make setup` "
            "(or `python link/dialect/regenerate.py`)"
        ) from missing


mavlink = _generated()

__all__ = ["mavlink"]
