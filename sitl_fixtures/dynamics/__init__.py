"""The aircraft: motion, control, estimate, battery."""
