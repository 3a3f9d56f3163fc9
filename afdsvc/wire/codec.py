"""The one codec of transport and recordings: values to bytes, bytes to values.

Every ``decode_*`` raises `afdsvc.errors.BadInput`, and nothing else, for bytes that are not what they should be.
"""

from __future__ import annotations

from afdsvc.wire.block_codec import decode_block, encode_block
from afdsvc.wire.burst_codec import (
    decode_burst_reply,
    decode_burst_request,
    decode_burst_stop,
    decode_lease,
    decode_receipt,
    encode_burst_reply,
    encode_burst_request,
    encode_burst_stop,
    encode_lease,
    encode_receipt,
)
from afdsvc.wire.finding_codec import decode_finding, encode_finding
from afdsvc.wire.retune_codec import decode_retune_request, encode_retune_request
from afdsvc.wire.rig_codec import decode_description, decode_event, encode_description, encode_event
from afdsvc.wire.status_codec import (
    decode_alarm_change,
    decode_command,
    decode_command_reply,
    decode_status,
    encode_alarm_change,
    encode_command,
    encode_command_reply,
    encode_status,
)

__all__ = [
    "decode_alarm_change", "decode_block", "decode_burst_reply", "decode_burst_request", "decode_burst_stop", "decode_command",
    "decode_command_reply", "decode_description", "decode_event", "decode_finding", "decode_lease", "decode_receipt",
    "decode_retune_request", "decode_status",
    "encode_alarm_change", "encode_block", "encode_burst_reply", "encode_burst_request", "encode_burst_stop", "encode_command",
    "encode_command_reply", "encode_description", "encode_event", "encode_finding", "encode_lease", "encode_receipt",
    "encode_retune_request", "encode_status",
]
