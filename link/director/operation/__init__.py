"""What operators change in flight, and what they are told when the C2 link is lost."""
