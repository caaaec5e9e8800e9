"""Fits of whole trajectories: multiple shooting and output error (single shooting)."""
