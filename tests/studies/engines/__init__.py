"""Cost of the engines of the methods beside goals, floors, an earlier checkout, and other people's engines."""
