"""The page of the measured track: its pictures and its template."""
