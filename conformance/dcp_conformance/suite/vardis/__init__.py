"""Test cases of VarDis."""
