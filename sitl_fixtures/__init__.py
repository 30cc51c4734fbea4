"""A simulated autopilot speaking real MAVLink over UDP, recordings of real ones, and missions."""
