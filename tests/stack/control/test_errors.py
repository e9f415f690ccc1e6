"""Errors of the control interface."""

from __future__ import annotations

import pickle

from dcp_stack.control.client import ServiceError


def test_an_error_can_be_sent_to_another_process():
    error = ServiceError(-32602, "no such parameter", {"parameter": "x"})
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.code, copy.message, copy.data) == (str(error), error.code, error.message, error.data)
    assert str(error) == "no such parameter"
