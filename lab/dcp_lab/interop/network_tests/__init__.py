"""The network tests, one module for each concern."""
