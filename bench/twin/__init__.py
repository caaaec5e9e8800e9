"""Live tracking: an online method applied to a stream of text lines, with output as JSON, in the terminal, on a
page."""
