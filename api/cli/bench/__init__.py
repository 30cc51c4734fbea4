"""``skyrelay bench``: the commands, their options, and how figures are printed; `api.bench` measures."""
