"""Stored cells: what a cell is, what computed it, where it lies, who is at work on it."""
