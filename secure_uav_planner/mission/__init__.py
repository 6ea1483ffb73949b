"""What is asked: the mission, its participants and their limits, and its files."""
