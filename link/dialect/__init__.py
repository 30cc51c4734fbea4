"""The pinned MAVLink dialect: pymavlink's common.xml plus operator control, generated into one module.

``mavlink`` is the generated module: message classes ``MAVLink_<name>_message``, ids, enums and the ``MAVLink`` packer
and parser, wire protocol 2.0. It is typed as ``Any``: generated code is not ours to annotate.
"""

from link.dialect import skyrelay as mavlink

__all__ = ["mavlink"]
