"""What can be entered: the registered methods, and the reference rows beside them."""
