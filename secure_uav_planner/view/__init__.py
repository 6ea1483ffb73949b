"""Views of a plan for people: a picture, and a web page with a time slider."""
