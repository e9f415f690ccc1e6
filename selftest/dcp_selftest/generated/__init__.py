"""Generated mutants: random single changes in the source of the protocol cores, to measure how many the suite detects.

The hand-written mutants (:mod:`dcp_selftest.mutants`) are made with knowledge of the cases; these are not.
``sites`` lists all possible changes. ``trial`` runs the suite against one of them in a separate process. ``ledger``
holds the changes that cannot be observed from outside, with reasons. ``campaign`` draws and tries many changes.
"""
