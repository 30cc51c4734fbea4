"""Tables of the database. Rows are neither the domain's types nor HTTP's bodies; `gcs.store.store` converts.

Documents are kept as JSON text, byte for byte as written. Times are RFC 3339 text in UTC with microseconds, which
sorts as it should on every database.
"""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Column,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    text,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(column_0_N_label)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# SQLite numbers rows by itself only for a column of the very type INTEGER.
_Number = BigInteger().with_variant(Integer, "sqlite")
_Time = String(32)
_Id = String(64)
# In the order of its characters, whatever the locale of the database.
_Sorted = String(64).with_variant(String(64, collation="C"), "postgresql")

missions = Table(
    "missions",
    metadata,
    Column("number", _Number, primary_key=True, autoincrement=True),
    Column("id", _Id, nullable=False, unique=True),
    Column("name", String(200), nullable=False),
    Column("latest_version", Integer, nullable=False),
    Column("created_utc", _Time, nullable=False),
    Column("archived_utc", _Time),
)

mission_versions = Table(
    "mission_versions",
    metadata,
    Column("number", _Number, primary_key=True, autoincrement=True),
    Column("mission_id", _Id, ForeignKey("missions.id"), nullable=False),
    Column("version", Integer, nullable=False),
    Column("document", Text, nullable=False),
    Column("status", String(16), nullable=False),
    Column("phase", String(64), nullable=False),
    Column("progress", Double, nullable=False),
    Column("plan", Text),
    Column("plan_sha256", String(64)),
    Column("infeasibility", Text),
    Column("error", Text),
    Column("created_utc", _Time, nullable=False),
    Column("changed_utc", _Time, nullable=False),
    # The attempt that is planning it.
    Column("owner", _Id),
    # What lists show of the plan, so that they need not read it.
    Column("mission_time_s", Double),
    Column("handover_count", Integer),
    # The mission's number in its latest version (null in the others), and the same until it is archived: a page is
    # a stretch of one of these indexes, however long the history is.
    Column("latest_number", _Number),
    Column("listed_number", _Number),
    UniqueConstraint("mission_id", "version"),
    Index("uq_mission_versions_latest_number", "latest_number", unique=True),
    Index("uq_mission_versions_listed_number", "listed_number", unique=True),
    Index("ix_mission_versions_status_latest_number", "status", "latest_number"),
    Index("ix_mission_versions_status_listed_number", "status", "listed_number"),
    Index("ix_mission_versions_status_number", "status", "number"),
    Index("ix_mission_versions_plan_sha256", "plan_sha256"),
)

idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    Column("scope", String(200), primary_key=True),
    Column("key", String(255), primary_key=True),
    Column("request_sha256", String(64), nullable=False),
    Column("mission_id", _Id, nullable=False),
    Column("version", Integer, nullable=False),
    Column("created_utc", _Time, nullable=False),
    ForeignKeyConstraint(["mission_id", "version"], ["mission_versions.mission_id", "mission_versions.version"]),
)

registry = Table(
    "registry",
    metadata,
    Column("kind", String(16), primary_key=True),
    Column("id", _Sorted, primary_key=True),
    Column("document", Text, nullable=False),
    Column("revision", Integer, nullable=False),
    Column("created_utc", _Time, nullable=False),
    Column("changed_utc", _Time, nullable=False),
)

flights = Table(
    "flights",
    metadata,
    Column("number", _Number, primary_key=True, autoincrement=True),
    Column("id", _Id, nullable=False, unique=True),
    Column("mission_id", _Id, nullable=False),
    Column("version", Integer, nullable=False),
    Column("plan_sha256", String(64), nullable=False),
    Column("vehicle_id", _Id, nullable=False),
    Column("state", String(32), nullable=False),
    Column("document", Text, nullable=False),
    Column("created_utc", _Time, nullable=False),
    Column("changed_utc", _Time, nullable=False),
    Column("ended_utc", _Time),
    # Which vehicle it is by its own word, once it was asked; and the service whose flight this is.
    Column("vehicle_identity", String(128)),
    Column("owner", _Id),
    ForeignKeyConstraint(["mission_id", "version"], ["mission_versions.mission_id", "mission_versions.version"]),
    Index("ix_flights_mission_id", "mission_id"),
    Index("ix_flights_vehicle_id", "vehicle_id"),
    Index(
        "uq_flights_running_vehicle_identity",
        "vehicle_identity",
        unique=True,
        sqlite_where=text("ended_utc IS NULL"),
        postgresql_where=text("ended_utc IS NULL"),
    ),
)

flight_events = Table(
    "flight_events",
    metadata,
    Column("flight_id", _Id, ForeignKey("flights.id"), primary_key=True),
    Column("sequence", Integer, primary_key=True, autoincrement=False),
    Column("kind", String(32), nullable=False),
    Column("state", String(32), nullable=False),
    Column("utc", _Time, nullable=False),
    Column("document", Text, nullable=False),
)

write_probe = Table(
    "write_probe",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("checked_utc", _Time),
)
