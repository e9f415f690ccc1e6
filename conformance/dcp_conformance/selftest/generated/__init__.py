"""Generated mutants: random single changes in the source of the protocol cores, and which of them the suite notices.

The hand-written mutants (:mod:`dcp_conformance.selftest.mutants`) know the cases; these do not. ``sites`` lists every
change
that can be made, ``trial`` runs the suite against one of them in a process of its own, ``ledger`` holds those that
cannot be seen from outside, with the reason, ``campaign`` draws and runs many.
"""
