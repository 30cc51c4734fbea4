"""Settings of the service, in one place; every other module receives values.

Each can be given as an environment variable ``SKYRELAY_<NAME>`` (case does not matter). Times are seconds, sizes bytes.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict


def default_data_dir() -> Path:
    """Where data goes unless told: ``$XDG_DATA_HOME/skyrelay``, else ``~/.local/share/skyrelay``."""
    base = os.environ.get("XDG_DATA_HOME")
    return (Path(base) if base else Path.home() / ".local" / "share") / "skyrelay"


def default_state_dir() -> Path:
    """What flights of this machine leave for whoever comes next: ``$SKYRELAY_STATE_DIR``, else ``/var/lib/skyrelay``.

    Where the latter is not there or may not be written: ``$XDG_STATE_HOME/skyrelay``, else ``~/.local/state/skyrelay``.
    Never a temporary folder: two services with folders of their own must meet here, and a restart must find it.
    """
    given = os.environ.get("SKYRELAY_STATE_DIR")
    if given:
        return Path(given).expanduser().absolute()
    system = Path("/var/lib/skyrelay")
    if system.is_dir() and os.access(system, os.W_OK | os.X_OK):
        return system
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "skyrelay"


class Settings(BaseSettings):
    """What can be set. Unknown ``SKYRELAY_`` variables are ignored; values out of range raise ``ValidationError``."""

    model_config = SettingsConfigDict(env_prefix="SKYRELAY_", env_ignore_empty=True, extra="forbid", frozen=True)

    data_dir: Path = Field(default_factory=default_data_dir, description="Database, logs and signing stamps live here.")
    database_url: str | None = Field(
        default=None,
        description="Address of the database, postgresql://USER@HOST/DATABASE or sqlite:///FILE; default a SQLite file "
        "in data_dir. PostgreSQL serves several planners on several machines.",
    )
    planner_processes: int = Field(
        default_factory=lambda: max(1, min(4, (os.cpu_count() or 2) - 1)),
        ge=0,
        le=256,
        description="Planning processes of the service; 0 leaves planning to `skyrelay worker`.",
    )
    planning_limit_s: float = Field(
        default=60.0, gt=0, le=3600, description="A planner that takes longer is killed, and the fallback method tried."
    )
    max_document_bytes: int = Field(
        default=10_000_000, ge=1_000, le=100_000_000, description="Largest mission document."
    )
    max_stations: int = Field(
        default=30_000,
        ge=1,
        le=100_000,
        description="Most stations of a mission; a document of so many must fit into max_document_bytes too.",
    )
    max_queued_missions: int = Field(default=1_000, ge=1, description="Missions that may wait for a planner.")
    allowed_hosts: Annotated[tuple[str, ...], NoDecode] = Field(
        default=(),
        description="Names the service may be called by beside localhost and any IP address, with commas between them; "
        "*.example.org stands for every name under it.",
    )
    max_connections: int = Field(default=512, ge=8, le=100_000, description="HTTP connections at once.")
    max_body_bytes: int = Field(
        default=1_000_000, ge=1_000, le=100_000_000, description="Largest body of a request that is no mission."
    )
    headers_timeout_s: float = Field(default=10.0, gt=0, le=600, description="How long a request's head may take.")
    body_timeout_s: float = Field(default=60.0, gt=0, le=3600, description="How long a request's body may take.")
    reading_timeout_s: float = Field(
        default=60.0, gt=0, le=3600, description="How long an answer may wait for somebody to read on."
    )
    lock_timeout_s: float = Field(default=5.0, gt=0, le=60, description="How long to wait for a locked database.")
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_style: Literal["console", "json"] = "console"

    @field_validator("data_dir")
    @classmethod
    def _absolute(cls, value: Path) -> Path:
        return value.expanduser().absolute()

    @field_validator("allowed_hosts", mode="before")
    @classmethod
    def _names(cls, value: object) -> object:
        return [name.strip() for name in value.split(",") if name.strip()] if isinstance(value, str) else value

    @field_validator("allowed_hosts")
    @classmethod
    def _patterns(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            if not re.fullmatch(r"(\*\.)?[A-Za-z0-9-]+(\.[A-Za-z0-9-]+)*", name):
                raise ValueError(f"{name!r} is no host name; allowed: ops.example.org or *.example.org, without a port")
        return tuple(name.lower() for name in value)

    @property
    def url(self) -> str:
        """The database's address, whether given or not."""
        return self.database_url or f"sqlite:///{self.data_dir / 'skyrelay.db'}"

    @property
    def shown_url(self) -> str:
        """The database's address for people and logs: without its password."""
        return re.sub(r"(?<=://)([^:@/]*):[^@]*@", r"\1:***@", self.url)

    def prepare(self) -> None:
        """Make ``data_dir``, for its owner alone; one that is there already is closed to others. Raises ``OSError``.

        Plans, contacts and signing keys are in there, and SQLite makes its files as the folder's mask allows.
        """
        self.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        if self.data_dir.stat().st_mode & 0o077:
            # Only its owner may: for anybody else this is the error that says so.
            self.data_dir.chmod(0o700)
