"""Cost of the engines of the methods beside goals, an earlier checkout, and other people's engines."""
