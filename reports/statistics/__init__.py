"""How a verdict is reached: estimates with their errors, the rule, and where a difference lies."""
