"""The simulator as a process, and a lossy proxy."""
