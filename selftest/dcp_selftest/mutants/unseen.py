"""Reasons why a mutant is not tried on versions that have its requirement (argument ``unseen`` of a mutant)."""

from __future__ import annotations

from typing import Final

BEFORE_2_0: Final = "1.0 1.1 1.2 1.3"

ALWAYS_ACTIVE: Final = {"1.0 1.1": "no service deactivates VarDis before 1.2"}
OTHERS_ACTIVE: Final = {"1.0 1.1": "no service can make the other protocols idle before 1.2"}
NO_TIMES: Final = {BEFORE_2_0: "VarSpecT has neither creationTime nor timeout before 2.0"}
NOT_ANEW: Final = {BEFORE_2_0: "an existing variable cannot be created again before 2.0"}
NOT_REPLACED: Final = {BEFORE_2_0: "a VarCreate of a known variable changes nothing before 2.0"}
PURGED: Final = {"1.0 1.1 1.2": "composing removes deleted variables from the queues up to 1.2 (VD-CMP-14)"}
RIGHT_SINCE_1_1: Final = {"1.1 1.2 1.3 2.0": "this is the required behaviour from 1.1 on"}
BP_ALWAYS_ACTIVE: Final = {"1.0 1.1": "no service deactivates BP before 1.2"}
NO_LENGTH: Final = {"1.0 1.1": "BPHeaderT has no length before 1.2"}
NO_NETWORK: Final = {BEFORE_2_0: "BPHeaderT has no networkId before 2.0"}
ONE_PAYLOAD: Final = {"1.0": "in 1.0 a beacon has at most one payload of a client"}
RIGHT_IN_2_0: Final = {"2.0": "this is the required behaviour from 2.0 on"}
NO_MODE: Final = {"1.0": "1.0 has no such queueing mode"}
NO_QUEUE: Final = {"1.1 1.2 1.3 2.0": "the mode QUEUE exists in 1.0 only"}
