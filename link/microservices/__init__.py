"""MAVLink's microservices: command, parameter, mission."""

from link.microservices.parameter_value import Parameter

__all__ = ["Parameter"]
