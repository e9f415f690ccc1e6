"""Which cases are run, and in which order, as far as that follows from measurements.

``data/case-times.json`` has how long each case takes at our node, and the smoke plan: the cases that notice most of the
known faults in a few seconds. ``dcp-conformance selftest --smoke-plan`` makes it (:mod:`.making`).
"""

from .times import Times, load

__all__ = ["Times", "load"]
