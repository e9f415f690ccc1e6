"""Test vectors: octets with their values or faults, and behaviour of a node, as data for unit tests in any language."""
