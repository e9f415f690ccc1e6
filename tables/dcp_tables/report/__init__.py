"""Recordings as a page of plots and tables; ``dcp-codec report``.

The page is made from the tables of :mod:`dcp_tables.table`: ``recorded`` reads the required columns. ``analysis``,
``variables``, ``holding`` and ``reactions`` compute numbers from them (NumPy, no drawing). ``chart`` and ``plots`` draw
the numbers with Bokeh (extra ``report``). ``sections`` and ``chapter`` create the text, tables and plots of one
recording, and ``page`` renders the page. docs/report.md describes the plots.
"""
