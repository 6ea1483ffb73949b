"""The node relay: setpoints in the messages of autopilots' stacks."""
