"""What is handed on: submissions of stored rows, merged stores, and exports for other tools."""
