"""The system under test (SUT): how it is opened, started, watched and ended."""
