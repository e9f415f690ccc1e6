"""A profile's wire format for other programs, generated from the plan (``dcp_codec.plan.tree``).

Each module turns one :class:`~dcp_codec.codec.Codec` into the text of one file. They are imported when an export is
asked for, not before: nobody who decodes pays for a generator.
"""
