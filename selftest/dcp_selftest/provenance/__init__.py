"""Where requirements come from: the statements of the specification that they stand on, version by version.

``statements`` splits the Markdown of a specification into sentences and steps with fingerprints, ``comparison`` aligns
two versions of it, ``checkout`` reads one from a folder or a git repository. ``anchors`` and ``recording`` write
``dcp_spec/data/origins.json`` (``dcp-selftest origins``); ``report`` compares it with another version
of the specification and says which requirements, cases and citations hang on what changed.
"""
