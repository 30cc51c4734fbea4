"""The ground side's domain: missions, geodesy, plans, schedules, flight states, exports, the store, jobs."""
