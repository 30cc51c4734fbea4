"""From mission to plan, and a flight planned anew under way."""
