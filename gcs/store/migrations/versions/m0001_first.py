"""Missions, registries, flights and their events.

`upgrade` is long because it is a table: one call a table of the database, one line a column.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer, "sqlite")
TIME, ID = sa.String(32), sa.String(64)


def upgrade() -> None:
    """Make the tables, and keep flight events from being changed or removed."""
    op.create_table(
        "missions",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        sa.Column("id", ID, nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("latest_version", sa.Integer, nullable=False),
        sa.Column("created_utc", TIME, nullable=False),
        sa.Column("archived_utc", TIME),
        sa.UniqueConstraint("id", name="uq_missions_id"),
    )
    op.create_table(
        "mission_versions",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        sa.Column("mission_id", ID, sa.ForeignKey("missions.id"), nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("document", sa.Text, nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("phase", sa.String(64), nullable=False),
        sa.Column("progress", sa.Double, nullable=False),
        sa.Column("plan", sa.Text),
        sa.Column("plan_sha256", sa.String(64)),
        sa.Column("infeasibility", sa.Text),
        sa.Column("error", sa.Text),
        sa.Column("created_utc", TIME, nullable=False),
        sa.Column("changed_utc", TIME, nullable=False),
        sa.Column("owner", ID),
        sa.Column("lease_utc", TIME),
        sa.UniqueConstraint("mission_id", "version", name="uq_mission_versions_mission_id_version"),
    )
    op.create_index("ix_mission_versions_status_number", "mission_versions", ["status", "number"])
    op.create_index("ix_mission_versions_plan_sha256", "mission_versions", ["plan_sha256"])
    op.create_table(
        "idempotency_keys",
        sa.Column("scope", sa.String(200), primary_key=True),
        sa.Column("key", sa.String(255), primary_key=True),
        sa.Column("request_sha256", sa.String(64), nullable=False),
        sa.Column("mission_id", ID, nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("created_utc", TIME, nullable=False),
        _of_version(),
    )
    op.create_table(
        "registry",
        sa.Column("kind", sa.String(16), primary_key=True),
        sa.Column("id", ID, primary_key=True),
        sa.Column("document", sa.Text, nullable=False),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("created_utc", TIME, nullable=False),
        sa.Column("changed_utc", TIME, nullable=False),
    )
    op.create_table(
        "flights",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        sa.Column("id", ID, nullable=False),
        sa.Column("mission_id", ID, nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("plan_sha256", sa.String(64), nullable=False),
        sa.Column("vehicle_id", ID, nullable=False),
        sa.Column("state", sa.String(32), nullable=False),
        sa.Column("document", sa.Text, nullable=False),
        sa.Column("created_utc", TIME, nullable=False),
        sa.Column("changed_utc", TIME, nullable=False),
        sa.Column("ended_utc", TIME),
        sa.UniqueConstraint("id", name="uq_flights_id"),
        _of_version(),
    )
    op.create_index("ix_flights_mission_id", "flights", ["mission_id"])
    op.create_index("ix_flights_vehicle_id", "flights", ["vehicle_id"])
    op.create_table(
        "flight_events",
        sa.Column("flight_id", ID, sa.ForeignKey("flights.id"), primary_key=True),
        sa.Column("sequence", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("state", sa.String(32), nullable=False),
        sa.Column("utc", TIME, nullable=False),
        sa.Column("document", sa.Text, nullable=False),
    )
    _append_only("flight_events")


def _of_version() -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(
        ["mission_id", "version"], ["mission_versions.mission_id", "mission_versions.version"]
    )


def _append_only(table: str) -> None:
    if op.get_bind().dialect.name == "sqlite":
        for action in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER {table}_no_{action.lower()} BEFORE {action} ON {table} "
                f"BEGIN SELECT RAISE(ABORT, '{table} is append-only'); END"
            )
        return
    op.execute(
        f"CREATE FUNCTION {table}_append_only() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{table} is append-only'; END $$"
    )
    op.execute(
        f"CREATE TRIGGER {table}_append_only BEFORE UPDATE OR DELETE ON {table} "
        f"FOR EACH ROW EXECUTE FUNCTION {table}_append_only()"
    )
