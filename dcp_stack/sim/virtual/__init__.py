"""Networks in virtual time: nodes on a simulated medium."""
