"""Networks of nodes by scenario: simulated in virtual time, or real processes on a virtual Ethernet."""
