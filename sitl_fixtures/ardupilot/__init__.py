"""ArduCopter's manners."""
