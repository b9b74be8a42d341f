"""What a run has found, on disk: its schema, images, tables, and what is read from them."""
