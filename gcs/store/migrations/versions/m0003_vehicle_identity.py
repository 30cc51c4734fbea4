"""Which vehicle a flight is of by the vehicle's own word, one running flight each; and whose service a flight is."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns, and the index that refuses a second running flight of one vehicle."""
    op.add_column("flights", sa.Column("vehicle_identity", sa.String(128)))
    op.add_column("flights", sa.Column("owner", sa.String(64)))
    running = sa.text("ended_utc IS NULL")
    op.create_index(
        "uq_flights_running_vehicle_identity",
        "flights",
        ["vehicle_identity"],
        unique=True,
        sqlite_where=running,
        postgresql_where=running,
    )
