"""Figures as specifications in Altair from tidy tables, for print and for a browser."""
