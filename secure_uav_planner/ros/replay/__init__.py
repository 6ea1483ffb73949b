"""The node replay: plans as setpoints in time."""
