"""Pictures as specifications in Altair: what is drawn of a tidy table, for print and for a browser."""
