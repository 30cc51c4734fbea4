"""MAVLink's own files and what is read off them: tlogs, setpoint files, reports."""
