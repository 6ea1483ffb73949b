"""The node planner: requests, replans, what it knows of the flight and of all poses."""
