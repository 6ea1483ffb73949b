"""The command, its campaigns, and the page on which a mission is dragged."""
