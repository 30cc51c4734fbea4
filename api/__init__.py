"""What people and programs touch: REST, the web page and the command line. Thin: it translates, wires and delegates.

Rooms, each importing only those before it: `api.service` and `api.processes`; `api.rest` and `api.bench`; `api.cli`.
"""
