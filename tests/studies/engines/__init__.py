"""What the engines of the methods cost: beside goals, floors, an earlier checkout, and other people's engines."""
