"""The streaming process and its supervisor."""
