"""``skyrelay backup`` and ``skyrelay restore``: safety copies of what the service keeps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli import inputs
from api.cli.errors import BadInputError, FaultError

_DATA = typer.Option("--data", help="Where missions and plans are kept.", metavar="DIR")


def register(app: typer.Typer, panel: str) -> None:
    """Add the commands."""
    app.command("backup", rich_help_panel=panel)(backup)
    app.command("restore", rich_help_panel=panel)(restore)


def backup(
    file: Annotated[Path, typer.Argument(help="The copy to make; one that is there is replaced.", metavar="FILE")],
    data_dir: Annotated[str | None, _DATA] = None,
) -> None:
    """Make a safety copy of the database, while the service runs.

    Missions, plans, registries, flights and their history; not the recordings in the data directory's `flights`.
    """
    from gcs.errors import StoreUnavailable
    from gcs.store import back_up

    settings = inputs.settings(data_dir=data_dir)
    try:
        back_up(settings.url, file)
    except StoreUnavailable as error:
        raise FaultError("no safety copy was made", {"where": settings.shown_url, "what": str(error)}) from None
    typer.echo(f"copied to {file}, {file.stat().st_size} bytes")


def restore(
    file: Annotated[Path, typer.Argument(help="A copy made by `skyrelay backup`.", metavar="FILE")],
    data_dir: Annotated[str | None, _DATA] = None,
) -> None:
    """Put a safety copy in the database's place. What is there now is gone: make a copy of it first.

    Whole or not at all; refused while a flight has not ended. Start the service anew afterwards.
    """
    from gcs.errors import ConflictError, StoreUnavailable
    from gcs.store import restore as put_back

    settings = inputs.settings(data_dir=data_dir)
    try:
        settings.prepare()
        put_back(settings.url, file)
    except (ConflictError, StoreUnavailable) as error:
        raise BadInputError("nothing was restored", {"where": str(file), "what": str(error)}) from None
    except OSError as error:
        raise BadInputError(
            "nothing was restored", {"where": str(settings.data_dir), "what": error.strerror or str(error)}
        ) from None
    typer.echo(f"restored {file}; start the service anew")
