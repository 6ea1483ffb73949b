"""The nodes that the command can run."""

NODES = ('planner', 'relay', 'replay')
