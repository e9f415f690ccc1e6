"""What the protocol is: wire profiles, construct schemas, constants, requirements and readings."""
