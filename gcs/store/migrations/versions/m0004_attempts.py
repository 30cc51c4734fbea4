"""Planning without leases: an attempt has its name, and whoever keeps the queue knows who is alive."""

from __future__ import annotations

from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Drop the column of the leases."""
    op.drop_column("mission_versions", "lease_utc")
