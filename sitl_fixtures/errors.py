"""What can go wrong when a simulator is set up.

::

    SimulatorError
    └── ConfigurationError    an option, a parameter or a fault that cannot be used

Nothing is raised for what arrives on the wire: a real autopilot answers bad traffic with silence or a refusal, and so
does this one.
"""

from __future__ import annotations


class SimulatorError(Exception):
    """Base of everything this package raises."""


class ConfigurationError(SimulatorError):
    """An option that cannot be used.

    Attributes:
        where: the option, e.g. ``--param``.
        value: what was given.
        allowed: what would have been accepted.
        fix: what to do.
    """

    def __init__(self, where: str, value: object, allowed: str, fix: str) -> None:
        super().__init__(f"{where}: {value!r} cannot be used; allowed: {allowed}; {fix}")
        self.where = where
        self.value = value
        self.allowed = allowed
        self.fix = fix
