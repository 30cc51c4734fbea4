"""All that differs between PX4 and ArduPilot."""
