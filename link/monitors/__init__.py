"""What is watched in flight: tracking, uplink, range, battery, control."""
