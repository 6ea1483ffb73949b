"""Mission files, and the notations in which they are written."""
