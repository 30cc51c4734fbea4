"""The commands, a file each: plan, handovers, setpoints, fly, flight, simulate, report, serve."""
