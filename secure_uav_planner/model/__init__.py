"""The physics: channels, limits, the flown curve and its clearances, the compiled kernel."""
