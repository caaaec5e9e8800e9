"""Online methods where the truth is simple: nothing changes, a fault, a long record."""
