"""Control interface and upper tester interface of a node: JSON-RPC 2.0, one message per line, without sockets.

``conformance/UPPER-TESTER.md`` specifies the interface.
"""
