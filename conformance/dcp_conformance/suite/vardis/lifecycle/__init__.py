"""Test cases of VarDis: initialization, runtime, timeouts and scrubbing."""
