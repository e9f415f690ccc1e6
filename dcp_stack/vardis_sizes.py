"""Sizes of VarDis records on the wire, and the ranges of their fields.

Layouts are the codec's business; the sizes here are sums over the widths that the profile states (DATA-02).
"""

from __future__ import annotations

from dcp_spec.constants import ICType, seqno_modulus
from dcp_spec.profile import IntType, Profile, TextType, standard_fields

from dcp_codec.values import VarCreate, VarSpec, VarUpdate


def _largest(layout: IntType) -> int:
    bits = 8 * layout.width - layout.signed
    return (1 << bits) - 1


def _overhead(layout: TextType) -> int:
    return sum(length.width for length in layout.lengths) + layout.terminated


def _longest(layout: TextType) -> int | None:
    return min((_largest(length) for length in layout.lengths), default=None)


class RecordSizes:
    """Sizes on the wire in octets, and the ranges of fields that applications fill."""

    def __init__(self, profile: Profile) -> None:
        types, layout = profile.types, profile.vardis
        self.ic_header = 2 + sum(each.width or 0 for each in layout.container_extra)
        self.ic_header += layout.list_length.width if layout.list_length is not None else 0
        self.var_id = types.var_id.width
        self.var_summ = self.var_id + types.var_seqno.width
        self._update = self.var_summ + _overhead(types.value)
        node_id = types.node_id
        self._id_varies = node_id.length is not None
        widths = {
            "varId": self.var_id,
            "prodId": node_id.length.width if node_id.length is not None else node_id.width,
            "repCnt": types.var_rep_cnt.width,
            "creationTime": types.timestamp.width,
            "timeout": types.var_timeout.width,
            "descr": _overhead(types.string),
        }
        self._spec = sum(widths[name] for name in standard_fields(layout.var_spec))
        varying = (ICType.CREATE_VARIABLES, ICType.UPDATES)
        bare = (ICType.DELETE_VARIABLES, ICType.REQUEST_VARCREATES)
        self.fixed: dict[ICType, int | None] = {
            kind: None if kind in varying else self.var_id if kind in bare else self.var_summ for kind in ICType
        }
        """Octets of each record of a type, None for those with a value."""
        self.node_id_width = None if self._id_varies else node_id.width
        self.highest_var_id = _largest(types.var_id)
        self.highest_rep_cnt = _largest(types.var_rep_cnt)
        self.highest_timeout = _largest(types.var_timeout)
        self.longest_description = _longest(types.string)
        self.nul_terminated = types.string.terminated
        self.highest_stamp = _largest(types.timestamp.as_int())
        ##= VD-TYP-03
        self.seqno_modulus = seqno_modulus(types.var_seqno.width)

    def update(self, value: bytes) -> int:
        """A VarUpdate with this value."""
        return self._update + len(value)

    def create(self, spec: VarSpec, value: bytes) -> int:
        """A VarCreate of a variable with this value."""
        producer = len(spec.prod_id) if self._id_varies else 0
        return self._spec + producer + len(spec.descr) + self._update + len(value)

    def record(self, record: VarCreate | VarUpdate) -> int:
        """A decoded record of a type whose records have no fixed size."""
        if isinstance(record, VarCreate):
            return self.create(record.spec, record.upd.value)
        return self.update(record.value)
