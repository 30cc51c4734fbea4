"""The earth: ellipsoid, the mission's plane, bounds on what the plane gets wrong."""
