"""The earth: ellipsoid, the mission's plane, bounds on what the plane gets wrong."""

from gcs.geodesy.ellipsoid import WGS84_A_M, WGS84_E2
from gcs.geodesy.plane import Plane

__all__ = ["WGS84_A_M", "WGS84_E2", "Plane"]
