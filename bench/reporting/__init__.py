"""What people read: tables, figures, the page, and the text of terminals. Reads the store, computes no cell."""
