"""The wire layer measured: how punctual the streamer is beside a bare sender, what a handover costs, its rates.

Shows nothing here, on purpose: the bare sender (`api.bench.link.sender`) is a process of its own that must not load the
rest. Callers name the module: `punctuality`, `rates`.
"""
