"""Alembic's entry: migrates over the connection `gcs.store.database` hands in."""

from __future__ import annotations

from alembic import context

from gcs.store.tables import metadata

connection = context.config.attributes["connection"]
# SQLite cannot alter most things in place: tables are rebuilt in a batch.
context.configure(connection=connection, target_metadata=metadata, render_as_batch=connection.dialect.name == "sqlite")
with context.begin_transaction():
    context.run_migrations()
