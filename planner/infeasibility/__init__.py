"""What makes a problem impossible, and the changes that would help."""
