"""Exhaustive exploration of small networks of real VarDis cores: every sequence of events up to given numbers."""
