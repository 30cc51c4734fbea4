"""What a machine or a vehicle has and lacks."""
