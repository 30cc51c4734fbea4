"""What must hold before anything is armed."""
