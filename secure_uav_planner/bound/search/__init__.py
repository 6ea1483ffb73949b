"""What may be wrong: the search for multipliers with which the proof is tight."""
