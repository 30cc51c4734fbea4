"""PX4's manners."""
