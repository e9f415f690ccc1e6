"""Test cases of BP: services for client protocols, and its parameters."""
