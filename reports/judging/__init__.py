"""Images of any renderer judged: one comparison, a suite of them, all against all; its pages, and gates for CI."""
