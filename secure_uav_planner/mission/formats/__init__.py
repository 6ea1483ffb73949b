"""Mission files and airspace files, and the notations in which they are written."""
