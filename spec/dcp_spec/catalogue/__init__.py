"""The catalogue: requirements, readings of contradictory text, and where each stands in the specification."""
