"""Fuzzers: whatever a record or a command line holds, the answer is a result or one line that says what is wrong."""
