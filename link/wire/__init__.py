"""Bytes and messages: codec, signing, the timestamps signing keeps."""
