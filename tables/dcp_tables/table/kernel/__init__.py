"""The columnar decoder: generated from a plan, compiled by Numba, and stored in the user's cache."""
