"""What is to be flown: the mission, its document, system ids, hours."""
