"""Citations of requirements in our own code (``##= ID``), and a check that they stand in the right place.

``places`` finds them. ``changes`` lists what can be changed in the code that a citation stands on, ``trial`` and
``unit_tests`` run the cases and tests that name the requirement against each change, ``campaign`` does that for many
citations. If no case and no test with the requirement notices any change, the citation stands in the wrong place, or
the ``ledger`` says why it cannot be noticed.
"""
