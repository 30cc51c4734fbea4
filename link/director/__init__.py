"""The flight director: procedures and states from preflight to landing."""
