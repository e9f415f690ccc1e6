"""Tools for this repository; no part of an installation."""
