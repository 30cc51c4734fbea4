"""The balls a trajectory goes through piece by piece, and first polylines in them."""
