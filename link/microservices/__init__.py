"""MAVLink's microservices: command, parameter, mission."""
