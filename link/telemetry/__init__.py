"""What the vehicle says, over which link, how old."""
