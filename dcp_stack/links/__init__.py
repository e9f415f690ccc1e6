"""Links: what carries bearer payloads between nodes. Each is imported when it is used."""
