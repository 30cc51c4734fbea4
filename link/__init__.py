"""Everything on the wire: dialect, setpoints, links, handover, the flight director."""
