"""Fits of whole trajectories: multiple shooting, and output error from one cold start."""
