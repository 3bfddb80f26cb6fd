# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A protocol handler that hands out each column as the bytes that Cassandra stores.

Our columns are encoded straight from the wire buffer and go back into one, so decoding them
into Python values and encoding those again would cost twice and change signalling NaNs.
"""

from __future__ import annotations

from typing import Any

from cassandra.cqltypes import BytesType
from cassandra.protocol import ProtocolHandler, ResultMessage


def _asBytes(metadata: Any) -> Any:
    return [(*column[:3], BytesType) for column in metadata] if metadata else metadata


_Decoding = ProtocolHandler.message_types_by_opcode[ResultMessage.opcode]


class _RawResultMessage(_Decoding):  # type: ignore[misc, valid-type]
    column_metadata: Any

    def recv_results_metadata(self, f: Any, user_type_map: Any) -> None:
        super().recv_results_metadata(f, user_type_map)
        self.column_metadata = _asBytes(self.column_metadata)

    def recv_results_rows(
        self, f: Any, version: int, user_type_map: Any, result_metadata: Any, policy: Any
    ) -> None:
        # The compiled parser binds self.recv_results_metadata, so ours above is called.
        super().recv_results_rows(f, version, user_type_map, _asBytes(result_metadata), policy)


class RawProtocolHandler(ProtocolHandler):
    """Like the driver's handler, but every column of a row is bytes or None."""

    message_types_by_opcode = {
        **ProtocolHandler.message_types_by_opcode,
        ResultMessage.opcode: _RawResultMessage,
    }
