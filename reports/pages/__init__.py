"""What is found, as pages that open from the disk without network."""
