"""Records without the fields that a profile adds to them are encoded with zeros there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dcp_codec import EncodeError
from dcp_codec.values import Container, VarCreate, VarDelete, VarReqUpdate, VarSpec, VarSumm, VarUpdate

from ..odd_profiles import codec_of

CREATE = VarCreate(VarSpec(1, bytes(6), 1, b"d", 3, 0), VarUpdate(1, 2, b""))


@pytest.mark.parametrize("record", [VarSumm(1, 2), VarUpdate(1, 2, b"v"), VarDelete(1), CREATE])
def test_fields_that_were_not_given_are_zeros(record: Any, tmp_path: Path) -> None:
    codec = codec_of("odd-own", tmp_path)
    number = codec.profile.vardis.container_types.by_name()[record.IC_TYPE.label]
    (decoded,) = codec.decode_containers(codec.encode_containers((Container(number, (record,)),)))[0].records
    assert not any(decoded.extra)
    for other in (VarReqUpdate(1, 2), "record"):
        with pytest.raises(EncodeError, match="needs a Var"):
            codec.encode_containers((Container(number, (other,)),))


def test_a_wrong_field_of_such_a_record_is_named(tmp_path: Path) -> None:
    codec = codec_of("odd-own", tmp_path)
    number = codec.profile.vardis.container_types.by_name()["CREATE-VARIABLES"]
    wrong = VarCreate(CREATE.spec, VarUpdate(1, 256, b""))
    with pytest.raises(EncodeError, match="256 is not in") as caught:
        codec.encode_containers((Container(number, (wrong,)),))
    assert caught.value.path == "[0].records[0].upd.seqno"
