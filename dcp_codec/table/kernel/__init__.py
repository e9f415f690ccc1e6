"""The columnar decoder: generated from a plan, compiled by Numba, kept in the user's cache."""
