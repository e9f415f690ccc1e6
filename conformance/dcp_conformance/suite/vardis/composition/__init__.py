"""Test cases of VarDis: composition and forwarding of payloads."""
