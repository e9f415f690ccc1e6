"""The catalogue: requirements, readings of contradictory text, and the place of each in the specification."""
