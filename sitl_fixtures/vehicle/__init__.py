"""The whole vehicle."""
