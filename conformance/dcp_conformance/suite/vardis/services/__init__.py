"""Test cases of VarDis: services for applications, and their parameters."""
