"""The service behind REST: flights, replanning, metrics, logs."""
