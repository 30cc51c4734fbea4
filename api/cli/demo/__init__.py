"""``skyrelay demo``: one story (`story`), told in one process (`command`) or by the service (`through_service`)."""
