"""Exchange of results: submissions of stored cells, merged stores, and exports for other tools."""
