"""Exports of a profile's wire format for other programs, generated from the plan (``dcp_codec.plan.tree``).

Each module turns one :class:`~dcp_codec.codec.Codec` into the text of one file. The modules are imported on use only,
so that decoding does not load them.
"""
