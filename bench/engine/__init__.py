"""Execution of a plan: the worker pool, the processes that fit and score a cell, launchers, progress."""
