"""Make the documentation site: stage the pages of ``docs/``, generate the reference, run Zensical.

``python -m tools.docs`` (``make docs``) writes ``site/``. These modules are not part of an installation.
"""
