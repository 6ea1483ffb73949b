"""What people see of a plan: a picture, and a page with a slider through time."""
