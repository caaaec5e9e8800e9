"""Reading of measured records: signals of files and arrays; ambiguous files are rejected."""

from bench.records.reading.recording import of_arrays, read_recording, read_recordings
from bench.records.reading.table import ReadOptions, Recording, Signal

__all__ = ["ReadOptions", "Recording", "Signal", "of_arrays", "read_recording", "read_recordings"]
