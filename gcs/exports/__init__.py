"""Plans and schedules in other forms."""
