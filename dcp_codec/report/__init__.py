"""Recordings as a page with the plots that people look at first; ``dcp-codec report``.

Drawn from the tables of :mod:`dcp_codec.table`: ``recorded`` gathers what is needed of them, ``analysis`` and
``variables`` turn it into numbers, ``canvas`` and ``figures`` draw those with matplotlib (extra ``report``), ``page``
puts the page together. docs/report.md says what each plot shows.
"""
