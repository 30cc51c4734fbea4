"""``skyrelay serve``: the service and its page."""

from __future__ import annotations

import ipaddress
import signal
import socket
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from api.cli import inputs
from api.cli.errors import BadInputError

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from gcs.settings import Settings

# How long an answer under way may go on when the service is asked to stop.
_GRACE_S = 5


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("serve", rich_help_panel=panel)(serve)


def serve(
    host: Annotated[str, typer.Option(help="Address to listen on.", metavar="ADDRESS")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port; 0 takes a free one.", metavar="PORT")] = 8000,
    data_dir: Annotated[
        str | None, typer.Option("--data", help="Where missions and plans are kept.", metavar="DIR")
    ] = None,
    log_style: Annotated[
        Literal["console", "json"] | None, typer.Option(help="Log lines for people or for machines.")
    ] = None,
    log_level: Annotated[
        Literal["debug", "info", "warning", "error"] | None, typer.Option(help="The least important lines to log.")
    ] = None,
    open_to_network: Annotated[
        bool,
        typer.Option(
            "--expose",
            help="Let other machines reach it with a --host of theirs to see. Whoever does can plan and fly: "
            "there are no accounts yet.",
        ),
    ] = False,
) -> None:
    """Run the service: REST under /v1, and a page to read in a browser.

    It prints its address once it is ready, and ends with Ctrl-C. Only this machine can reach it unless told otherwise.
    """
    if not open_to_network and not _is_loopback(host):
        raise BadInputError(
            "the service would be open to the network, and it has no accounts yet",
            {
                "where": "--host",
                "value": host,
                "allowed": "an address of this machine alone, such as 127.0.0.1",
                "fix": "reach it through an SSH tunnel, or add --expose on a network you trust",
            },
        )
    settings = inputs.settings(data_dir=data_dir, log_style=log_style, log_level=log_level)
    with listen(host, port) as listener:
        _check_store(settings)
        from api.rest import create_app
        from api.service import configure_logging

        configure_logging(settings.log_style, settings.log_level)
        run(create_app(settings), listener, settings)


def _check_store(settings: Settings) -> None:
    """Open the store once before the service does, so that what is wrong with it is said in one block."""
    from gcs.errors import StoreUnavailable
    from gcs.store import DataOwner, Store

    try:
        settings.prepare()
    except OSError as error:
        raise BadInputError(
            "the data cannot be kept there",
            {
                "where": str(settings.data_dir),
                "what": error.strerror or str(error),
                "fix": "name another place with --data, or restore a safety copy",
            },
        ) from None
    try:
        DataOwner(settings.data_dir).close()
    except StoreUnavailable as error:
        raise BadInputError(
            "the data directory is in use",
            {"where": str(settings.data_dir), "what": str(error), "fix": "stop that service, or name another --data"},
        ) from None
    try:
        Store(settings.url, lock_timeout_s=settings.lock_timeout_s).close()
    except StoreUnavailable as error:
        raise BadInputError(
            "the store cannot be used",
            {"where": settings.shown_url, "what": str(error), "fix": _store_fix(settings)},
        ) from None


def _store_fix(settings: Settings) -> str:
    if settings.database_url is None:
        return "name another place with --data, or restore a safety copy (`skyrelay restore`)"
    return (
        "start the database there, or correct SKYRELAY_DATABASE_URL: postgresql://USER@HOST/DATABASE; without it the "
        "missions are kept in a file"
    )


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def listen(host: str, port: int) -> socket.socket:
    """A bound listening socket. Raises `BadInputError` when the address or port cannot be had."""
    try:
        family, _, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise BadInputError(
            "the address to listen on is not known",
            {"where": "--host", "value": host, "what": error.strerror, "fix": "use an IP address of this machine"},
        ) from None
    # Named, because asyncio sends without delay (TCP_NODELAY) only where the protocol says TCP: an answer on a kept
    # connection would wait some 40 ms for the acknowledgement of the one before.
    listener = socket.socket(family, socket.SOCK_STREAM, protocol or socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
        listener.listen(512)
    except OSError as error:
        listener.close()
        raise BadInputError(
            f"port {port} of {host} cannot be had",
            {
                "where": "--port",
                "value": str(port),
                "what": error.strerror,
                "fix": "stop the program that has it, or let `--port 0` find a free one",
            },
        ) from None
    listener.set_inheritable(False)
    return listener


def run(application: ASGIApp, listener: socket.socket, settings: Settings) -> None:
    """Serve until a signal; print the address when ready."""
    import uvicorn

    from api.rest import BACKLOG, Limits, connection_class, possible_connections

    limits = Limits(
        settings.headers_timeout_s,
        settings.body_timeout_s,
        settings.reading_timeout_s,
        possible_connections(settings.max_connections),
    )

    name, port = listener.getsockname()[:2]
    shown = f"[{name}]" if ":" in name else name

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets=sockets)
            if self.started:
                typer.echo(f"skyrelay serves at http://{shown}:{port}/")

    config = uvicorn.Config(
        application,
        http=connection_class(limits),
        backlog=BACKLOG,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=_GRACE_S,
        ws_max_size=65536,
    )
    # Being asked to end is no fault: with the signal ignored around the server, it stops in order and exits with 0.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    Server(config).run(sockets=[listener])
