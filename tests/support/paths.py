"""Where things of the checkout are."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MISSIONS = ROOT / "sitl_fixtures" / "missions"
RECORDINGS = ROOT / "sitl_fixtures" / "recordings"
