"""Byte pipes, and the gate every frame leaves by."""
