"""The live twin: an online method on a stream of lines, its answers as JSON, in the terminal and on a page."""
