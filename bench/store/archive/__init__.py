"""The published archive: cells that a clone carries, in a few Parquet files; read-only but for ``bench.publish``."""
