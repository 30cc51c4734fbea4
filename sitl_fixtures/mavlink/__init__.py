"""The vehicle's side of MAVLink."""
