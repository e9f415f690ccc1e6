"""Networks in virtual time: a medium, a clock with its queue of events, and stations."""
