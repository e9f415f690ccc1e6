"""A check of the citations of requirements (``##= ID``) in our own code: is the cited code the code that fulfils them?

``places`` finds the citations. ``changes`` lists the possible changes of the cited code. ``trial`` and ``unit_tests``
run the cases and tests that name the requirement against a change, and ``campaign`` does so for many citations. If no
case and no test with the requirement detects any change, the citation is in the wrong place, unless the ``ledger`` has
a reason why no change can be detected.
"""
