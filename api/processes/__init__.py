"""Child processes of commands: the simulator and others."""
