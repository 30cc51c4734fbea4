"""What the parts of one flight share: its request, clock, events, control."""
