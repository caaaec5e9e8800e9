"""Sweeps beyond one machine, tried and measured on one: Ray, Slurm, and what a million cells take."""
