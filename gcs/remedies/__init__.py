"""What would make an impossible mission possible, tried and put into words."""
