"""The test system as a test case sees it.

:class:`~dcp_conformance.test_system.bench.Bench` is the interface of one case to the tester. It connects parts that can
be constructed and tested alone:

============  ==============================================================================
``steps``     times of the tester's steps, and its lateness
``sut``       known properties of the implementation: parameters, reaction time, profile
``known``     findings about the implementation before the first case
``judgement`` checks, losses of the tester, and excuses for failed checks
``identifiers`` identifiers of nodes and variables
``sending``   records, virtual nodes (peers), transmission of frames
``reception`` received frames, and waiting for them
``services``  calls through the upper tester, and the calls that undo their effects
``probes``    stimuli that must be answered
``control``   restart of the implementation, and of its link
============  ==============================================================================

:class:`~dcp_conformance.test_system.session.Session` lasts from case to case.
"""
