"""Wire profiles: their definition, rules, loading and reference."""
