# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is to be recorded, and how: the options of a recorder."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Mapping, Optional, Sequence

from cassandra_ros.recording.recording import DEFAULT_BUFFER_BYTES


@dataclass(frozen=True)
class RecorderOptions:
    """What to record, and how; the options of the program ``recorder`` have the same names."""

    topics: Sequence[str] = ()
    """Names, or regular expressions."""
    all: bool = False
    """Every topic, also one that comes later."""
    regex: bool = False
    """``topics`` are regular expressions, for whole names."""
    exclude: str = ""
    """Regular expression of topics that are left out."""
    format: Optional[str] = None
    """As addTopic takes it."""
    node_id: str = ""
    """The robot or entity that is recorded."""
    duration: float = 0.0
    """Seconds; 0 = until it is stopped."""
    limit: int = 0
    """Messages of each topic; 0 = all."""
    buffsize: int = DEFAULT_BUFFER_BYTES
    """Most bytes that wait for the store; 0 = no bound."""
    ttl: int = 0
    """Seconds until a message of a new topic expires; 0 = never."""
    tcpnodelay: bool = False
    """Ask publishers to send at once."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """What is kept with each run."""

    @property
    def discovers(self) -> bool:
        """Whether topics are chosen while they appear."""
        return self.all or self.regex

    def excludes(self, topic: str) -> bool:
        """Say whether a topic is left out whatever else is said."""
        return bool(self.exclude and re.fullmatch(self.exclude, topic))

    def chooses(self, topic: str) -> bool:
        """Say whether a topic that appeared is to be recorded."""
        wanted = self.all or any(re.fullmatch(name, topic) for name in self.topics)
        return wanted and not self.excludes(topic)
