"""What is kept: missions, plans, flights, registries; SQLite by default."""
