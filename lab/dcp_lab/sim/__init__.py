"""Networks of nodes described by a scenario: simulated in virtual time, or processes on a virtual Ethernet."""
