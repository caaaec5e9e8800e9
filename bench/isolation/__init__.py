"""Child processes with limits of time and memory, isolated from the program that starts them."""
