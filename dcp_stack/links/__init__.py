"""Links carry bearer payloads between nodes. Each module is imported only when its link is used."""
