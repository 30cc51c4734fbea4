"""What lists show as columns, and indexes a page is a stretch of."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer, "sqlite")
_AT_ONCE = 200


def upgrade() -> None:
    """Add the columns, fill them from what is kept, index them."""
    for name, kind in (
        ("mission_time_s", sa.Double()),
        ("handover_count", sa.Integer()),
        ("latest_number", NUMBER),
        ("listed_number", NUMBER),
    ):
        op.add_column("mission_versions", sa.Column(name, kind))
    of_mission = "FROM missions m WHERE m.id = mission_versions.mission_id AND m.latest_version = version"
    op.execute(f"UPDATE mission_versions SET latest_number = (SELECT m.number {of_mission})")
    op.execute(f"UPDATE mission_versions SET listed_number = (SELECT m.number {of_mission} AND m.archived_utc IS NULL)")
    _read_plans()
    for name in ("latest_number", "listed_number"):
        op.create_index(f"uq_mission_versions_{name}", "mission_versions", [name], unique=True)
        op.create_index(f"ix_mission_versions_status_{name}", "mission_versions", ["status", name])
    # Where the service asks whether it may still write.
    probe = op.create_table(
        "write_probe",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("checked_utc", sa.String(32)),
    )
    op.bulk_insert(probe, [{"id": 1, "checked_utc": None}])
    if op.get_bind().dialect.name != "sqlite":
        # In the order of its characters, as SQLite has it.
        op.execute('ALTER TABLE registry ALTER COLUMN id TYPE varchar(64) COLLATE "C"')
        # The same class of error as SQLite's.
        op.execute(
            "CREATE OR REPLACE FUNCTION flight_events_append_only() RETURNS trigger LANGUAGE plpgsql AS "
            "$$ BEGIN RAISE EXCEPTION 'flight_events is append-only' "
            "USING ERRCODE = 'integrity_constraint_violation'; END $$"
        )


def _read_plans() -> None:
    """The facts of every plan kept; one that cannot be read any more keeps none."""
    connection, last = op.get_bind(), 0
    some = sa.text(
        "SELECT number, plan FROM mission_versions "
        "WHERE number > :last AND plan IS NOT NULL ORDER BY number LIMIT :most"
    )
    note = sa.text(
        "UPDATE mission_versions SET mission_time_s = :time_s, handover_count = :count WHERE number = :number"
    )
    while rows := connection.execute(some, {"last": last, "most": _AT_ONCE}).all():
        for number, text in rows:
            try:
                plan = json.loads(text)
                facts = {"time_s": float(plan["mission_time_s"]), "count": len(plan["handovers"])}
            except (ValueError, KeyError, TypeError):
                continue
            connection.execute(note, {**facts, "number": number})
        last = rows[-1].number
