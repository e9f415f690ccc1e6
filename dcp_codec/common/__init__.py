"""Helpers for commands and writers: command lines, atomic writing of files, and text from untrusted sources."""
