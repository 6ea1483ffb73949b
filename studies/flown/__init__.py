"""Simulated flights: quadrotors with dynamics follow the replay's setpoints over DDS."""
