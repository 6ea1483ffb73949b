"""Programs: the command, campaigns, study, benchmark, flights in physics, demo."""
