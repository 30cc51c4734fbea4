"""``python -m api.cli``: the same as the ``skyrelay`` command."""

from api.cli import main

main()
