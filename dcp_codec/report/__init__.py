"""Recordings as a page of plots and tables; ``dcp-codec report``.

Made from the tables of :mod:`dcp_codec.table`: ``recorded`` gathers what is needed of them, ``analysis``,
``variables``, ``holding`` and ``reactions`` turn it into numbers (NumPy, no drawing), ``chart`` and ``plots`` draw
those with Bokeh (extra ``report``), ``sections`` and ``chapter`` say what there is to say of one
recording, and ``page`` puts the page
together. docs/report.md says what each plot shows.
"""
