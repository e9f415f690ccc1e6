"""Stateful testing of a whole node against its model: sequences of steps that Hypothesis draws and shrinks."""
