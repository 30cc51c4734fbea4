"""A command's arguments and options as one object, for commands that have many."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields
from typing import Any, TypeVar, get_type_hints

Options = TypeVar("Options")
Result = TypeVar("Result")


def command_of(options: type[Options], run: Callable[[Options], Result]) -> Callable[..., Result]:
    """``run`` as typer takes a command: with a parameter for each field of the dataclass ``options``.

    A field is annotated as a parameter would be, ``Annotated[type, typer.Option(...)]``; its default is the
    parameter's. The command's help is ``run``'s docstring.
    """
    hints = get_type_hints(options, include_extras=True)
    parameters = [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in fields(options)  # type: ignore[arg-type]
    ]

    @functools.wraps(run)
    def command(**given: Any) -> Result:
        return run(options(**given))

    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command
