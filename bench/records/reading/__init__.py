"""Reading measured records: :func:`read_recording` makes signals of a file, and refuses what it would have to guess."""

from bench.records.reading.recording import of_arrays, read_recording, read_recordings
from bench.records.reading.table import ReadOptions, Recording, Signal

__all__ = ["ReadOptions", "Recording", "Signal", "of_arrays", "read_recording", "read_recordings"]
