"""Test cases of VarDis: processing of received payloads."""
