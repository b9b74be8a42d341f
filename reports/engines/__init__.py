"""Any renderer as a command: the file that tells it, what it is asked, how it is run, probed, kept; furnaces."""
