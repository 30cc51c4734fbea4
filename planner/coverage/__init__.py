"""What stations cover: balls and elevation masks, discs at a height, overlaps, windows along a curve."""
