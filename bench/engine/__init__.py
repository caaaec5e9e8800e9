"""The engine of all experiments: tasks, the pool of processes that performs them, and progress."""
