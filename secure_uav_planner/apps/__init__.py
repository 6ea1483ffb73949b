"""The command and its campaigns."""
