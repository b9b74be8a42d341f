"""How it is computed: jobs, the cache that keeps what they made, and what runs them."""
