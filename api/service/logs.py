"""Logging: one line per event, JSON for machines or readable for people, on standard error."""

from __future__ import annotations

import logging
import sys

import structlog


def configure_logging(style: str = "console", level: str = "info") -> None:
    """Set up structlog and send the standard library's records (uvicorn, alembic) through it.

    ``style`` is ``"json"`` or ``"console"``; ``level`` a name such as ``"info"``.
    """
    shared: list[structlog.types.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    final: structlog.types.Processor
    if style == "json":
        shared.append(structlog.processors.format_exc_info)
        final = structlog.processors.JSONRenderer(sort_keys=True)
    else:
        final = structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(),
            # The default draws tracebacks with every local variable: seconds of work, while the service stands still.
            exception_formatter=structlog.dev.plain_traceback,
        )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, final],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    for name in ("uvicorn", "uvicorn.error", "uvicorn.access"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = name != "uvicorn.access"  # requests are logged once, by the middleware
    logging.getLogger("alembic.runtime.plugins").setLevel(logging.WARNING)
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=True,
    )
