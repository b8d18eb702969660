"""`siamloc fetch`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

from foundation.settings import Count, Positive, Text
from foundation.words import as_words
from siamloc.data.archives import ADDRESS
from siamloc.data.fetching import Fetched, fetch
from siamloc.data.protocol import ROLES, Protocol
from siamloc.errors import ConfigError, DataError
from siamloc.jobs.choices import Folder
from siamloc.jobs.job import Job, Say, quiet
from siamloc.jobs.options import choices, option


@dataclass(frozen=True, kw_only=True)
class Fetch(Job):
    """Load sequences of the COLD database and unpack them where data=cold looks for them.

    Loads what is not there yet, and replaces nothing. After a break, the same command continues. Each archive is
    checked before it is used, and SHA256SUMS in the folder lists the check sums, so that two laboratories can compare
    what they have.
    The addresses are known from others and were not checked; they are in siamloc/data/archives.py.

        sequences=[freiburg_a_seq2_cloudy3,...]   sequences, or patterns such as 'freiburg_a_seq2_*'
        protocol=freiburg    or the sequences of a protocol of COLD
        out=data/COLD        the folder of the database
        --list               load nothing, and list what is there and what is missing
        mirror=ADDRESS       a copy of the database
        keep=true            keep the archives
        timeout=60 tries=5   seconds without data that end an attempt; attempts in a row without any

    Example:
        $ siamloc fetch cold protocol=freiburg out=data/COLD
    """

    GROUPS: ClassVar[Mapping[str, str]] = {"protocol": "by_sequence"}
    ALONE = "kind"

    kind: Literal["cold"] = "cold"
    sequences: tuple[Text, ...] | Text = ()
    protocol: Protocol
    out: Folder = "data/COLD"
    mirror: Text = ADDRESS
    keep: bool = False
    list: bool = False
    timeout: Positive = 60.0
    tries: Count = 5

    def run(self, say: Say = quiet) -> Fetched:
        """Fetch the sequences, or list them."""
        if self.sequences and any(getattr(self.protocol, role).sequences for role in ROLES):
            raise ConfigError("give sequences=[...] or a protocol, not both: either one says what to fetch")
        load = partial(fetch, self.kind, self.sequences or self.protocol, self.out, mirror=self.mirror)
        try:
            found = load(keep=self.keep, timeout=self.timeout, tries=self.tries, only_list=self.list)
        except DataError:
            say(load(only_list=True).table())
            raise
        say(found.table())
        for note in found.notes:
            say(f"note: {note}")
        if not found.missing and not self.sequences:
            known = {name: Protocol.of(option("protocol", name).values) for name in choices("protocol")}
            if name := next((name for name, protocol in known.items() if protocol == self.protocol), None):
                root = as_words({"data.root": found.folder})
                say(f"next: siamloc train data=cold {root} protocol={name} experiment=modern")
        return found
